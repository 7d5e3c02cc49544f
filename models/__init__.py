"""The rods' equations: kernels, integrators, and the assemblies made of them."""

if __name__ != "multirod.models":
    raise ImportError(f"import 'multirod.models', not {__name__!r}")
