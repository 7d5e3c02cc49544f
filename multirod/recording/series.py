"""What a recording plots over time, and how far a run is from its reference."""

from collections.abc import Sequence

import numpy as np

from multirod.recording import columns
from multirod.recording.stage import Stage
from multirod.results.history import History
from multirod.results.remarks import Remarks
from multirod.validation import FloatArray


def told(remarks: Sequence[Remarks]) -> dict[str, FloatArray]:
    """Series of what tasks said, axes (sample, instance[, component])."""
    values: dict[str, FloatArray] = {}
    if remarks and remarks[0].target_error is not None:
        error = 1e3 * np.array([[said.target_error] for said in remarks], dtype=np.float64)
        values["/task/target_error_mm"], values["/task/target_error_mm_log10"] = error, columns.log10(error)
    if remarks and remarks[0].limits is not None:
        values["/task/limits"] = np.array([said.limits for said in remarks])[:, None]
    return values


def tips_of(block: History, reference: History | None) -> dict[str, FloatArray]:
    """Of all sources, axes (sample, instance, 3)."""
    sources = {"": block} if reference is None else {"": block, "reference/": reference}
    return {kind: np.reshape(source.tip_position, (len(block.time), -1, 3)) for kind, source in sources.items()}


def compared(block: History, reference: History | None) -> str:
    """What the reference is, as far as it is another."""
    if reference is None:
        return ""
    robot = "" if reference.assembly is block.assembly else repr(reference.assembly)
    return ", ".join(part for part in (robot, reference.description) if part)


def compare(shapes: dict[str, list[dict[str, FloatArray]]]) -> None:
    """Add to each rod's shape how far its nodes are from the reference's [mm]."""
    for shape, other in zip(shapes[""], shapes["reference/"], strict=True):
        shape["difference"] = 1e3 * np.linalg.norm(shape["position"] - other["position"], axis=-1, keepdims=True)


def scalars_of(stage: Stage, block: History, tips: dict[str, FloatArray]) -> dict[str, FloatArray]:
    """Series by entity, axes (sample, instance[, component])."""

    def split(values: object, *tail: int) -> FloatArray:
        return np.reshape(np.asarray(values, dtype=np.float64), (len(block.time), -1, *tail))

    residual, condition, least = split(block.residual), split(block.condition), split(block.smallest_singular_value)
    values = {
        "/error/boundary": residual,
        "/error/boundary_log10": columns.log10(residual),
        "/conditioning/condition": condition,
        "/conditioning/condition_log10": columns.log10(condition),
        "/conditioning/smallest_singular_value": least,
        "/conditioning/smallest_singular_value_log10": columns.log10(least),
        "/solver/iterations": split(block.iterations),
        "/solver/integrations": split(block.integrations),
    }
    if stage.lines:
        values["/lines/tension"] = split(block.tension, len(stage.lines))
        values["/lines/length_mm"] = 1e3 * split(block.line_length, len(stage.lines))
    if stage.blocks:
        every = split(block.boundary_residual, block.unknown_count)
        parts = [np.abs(every[..., part.residuals]).max(axis=-1) for part in stage.blocks]
        values["/error/blocks"] = np.stack(parts, axis=-1)
        values["/error/blocks_log10"] = columns.log10(values["/error/blocks"])
    if np.isfinite(block.step_time).any():
        values["/solver/step_time_ms"] = np.broadcast_to(1e3 * block.step_time[:, None], residual.shape)
        values["/solver/step_time_ms_log10"] = columns.log10(values["/solver/step_time_ms"])
    if "reference/" in tips:
        error = 1e3 * np.linalg.norm(tips[""] - tips["reference/"], axis=-1)
        values["/error/tip_mm"] = error
        values["/error/tip_mm_log10"] = columns.log10(error)
    for name in block.inputs.given:
        if block.inputs.profile(name) is None:
            value = getattr(block.inputs, name)
            width = value.shape[-1]
            values[f"/inputs/{name}"] = split(np.broadcast_to(value, (*block.batch_shape, width)), width)
    return values
