"""What moments are counted in, so that unknowns and residuals are curvatures (``docs/model.md``, equations 10 and 11)."""

import numpy as np

from multirod.validation import FloatArray


def unit_stiffness(material: FloatArray) -> FloatArray:
    """Bending about x and y and torsion [N m^2] of sections whose stiffnesses are ``material[..., :3]``, shape (..., 3).

    Where torsion is stiffer than bending, the bending stiffness scales it: a rod may not twist at all.
    """
    result = np.array(material[..., :3])
    result[..., 2] = np.minimum(result[..., 2], result[..., :2].max(axis=-1))
    return result
