"""Rotations as SciPy has them, which is loaded where they are needed."""

from multirod.validation import FloatArray


def matrices(vectors: FloatArray) -> FloatArray:
    """Rotation matrices (count, 3, 3) of rotation vectors (count, 3)."""
    from scipy.spatial.transform import Rotation

    result: FloatArray = Rotation.from_rotvec(vectors).as_matrix()
    return result


def vectors(matrices: FloatArray) -> FloatArray:
    """Rotation vectors (count, 3) of rotation matrices (count, 3, 3)."""
    from scipy.spatial.transform import Rotation

    result: FloatArray = Rotation.from_matrix(matrices).as_rotvec()
    return result
