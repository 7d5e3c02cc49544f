"""What each instance of a solution has one number of: attributes of ``Solution``, and what axes and legends call them."""

SCALARS = {
    "residual": "residual [1/m]",
    "condition": "condition number",
    "smallest_singular_value": "smallest singular value",
    "determinant": "determinant",
    "iterations": "iterations",
    "integrations": "integrations",
    "energy": "elastic energy [J]",
    "potential": "potential energy [J]",
    "stability_margin": "stability margin",
}
