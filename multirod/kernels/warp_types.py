"""Names for what Warp makes, where its own types say the wrong thing to type checkers."""

from typing import Any, TypeAlias

import warp as wp

Struct: TypeAlias = Any  # an object of a ``@wp.struct``: its fields are annotated with what they are within kernels
Array: TypeAlias = "wp.array[Any, int]"  # of any type and shape
Launch: TypeAlias = Any  # what ``multirod.launch.record`` makes: a recorded launch, or one that waits for its kernel
