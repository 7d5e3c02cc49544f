"""This machine as another one: `make test CPU=x86-64-v3 CORES=1`. Python imports it at its start where this folder is on
`PYTHONPATH`.

So it holds for every process that a test starts, too. `MULTIROD_TEST_CPU` is a processor as LLVM names it, whose instructions
this one
has: kernels are compiled for it, and NumPy and BLAS take the loops that they have for it. `MULTIROD_TEST_CORES` is how many cores
    a process believes it may use, which says how many threads share a batch.
"""

import os

# what NumPy and OpenBLAS choose by the processor, by name of the level that is asked for
WITHOUT = {"x86-64-v2": "X86_V3 X86_V4 AVX512_ICL AVX512_SPR", "x86-64-v3": "X86_V4 AVX512_ICL AVX512_SPR"}
BLAS = {"x86-64-v2": "Nehalem", "x86-64-v3": "Haswell", "x86-64-v4": "SkylakeX"}

if cpu := os.environ.get("MULTIROD_TEST_CPU"):
    os.environ.setdefault("NPY_DISABLE_CPU_FEATURES", WITHOUT.get(cpu, ""))
    if cpu in BLAS:
        os.environ.setdefault("OPENBLAS_CORETYPE", BLAS[cpu])

    import warp as wp

    # Warp passes flags on to Clang's frontend, which knows no other -march than Warp's own native
    wp.config.cpu_compiler_flags = (wp.config.cpu_compiler_flags or "").replace("-march=native", f"-target-cpu {cpu}")

if cores := os.environ.get("MULTIROD_TEST_CORES"):
    os.environ.setdefault("OPENBLAS_NUM_THREADS", cores)
    os.sched_getaffinity = lambda _: set(range(int(cores)))  # type: ignore[attr-defined]
