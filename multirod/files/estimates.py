"""Estimates and calibrations as tables: their equilibria, what was found, and how sure that is."""

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

import numpy as np

from multirod.files.results import limits_from, result_from, table_of_limits, table_of_result
from multirod.status import Status
from multirod.tasks.estimating.bounded import Bounds
from multirod.tasks.estimating.calibrate import Calibration
from multirod.tasks.estimating.estimate import Estimate
from multirod.tasks.estimating.fit import Odd
from multirod.tasks.estimating.fitted import Fitted

ARRAYS = {name: name for name in ("missing", "misfit", "degrees", "rejected")}  # of an estimate, and where it has them
ARRAYS |= {name: f"_{name}" for name in ("mean", "covariance", "prior")}


def table_of_estimate(result: Estimate[Any]) -> dict[str, Any]:
    """All that an estimate is made of.

    Raises:
        ValueError: If the robot or the integrator is of a class of another package.
    """
    return {
        "solution": table_of_result(result.solution),
        "places": {name: [place.start, place.stop] for name, place in result._places.items()},
        **{name: np.asarray(getattr(result, place)) for name, place in ARRAYS.items()},
        "dropped": result.dropped,
        "limits": table_of_limits(result._bounds.rows),
        "unit": result._bounds.unit,
    }


def estimate_from(table: Mapping[str, Any], where: str) -> Estimate[Any]:
    """The estimate of a table.

    Raises:
        ValueError: If it does not hold together.
    """
    solution = result_from(table["solution"], f"{where}solution.")
    places = {name: slice(*ends) for name, ends in table["places"].items()}
    arrays = {name: table[name] for name in ARRAYS}
    count = max((place.stop for place in places.values()), default=0)
    if arrays["mean"].shape != (*solution.batch_shape, count):
        raise ValueError(
            f"{where}mean of shape {arrays['mean'].shape} is not of {count} numbers of a batch {solution.batch_shape}"
        )
    bounds = Bounds(limits_from(table["limits"]), table["unit"])
    return Estimate(solution, places, dropped=tuple(table["dropped"]), bounds=bounds, **arrays)


def table_of_calibration(result: Calibration[Any]) -> dict[str, Any]:
    """All that a calibration is made of.

    Raises:
        ValueError: As ``table_of_estimate``.
    """
    return {
        **vars(result._found),
        "odd": result._found.odd and asdict(result._found.odd),
        "solution": table_of_result(result._solution),
        "places": [[name, place.start, place.stop] for name, place in result._found.places.items()],
        "status": int(result.status),
    }


def calibration_from(table: Mapping[str, Any], where: str) -> Calibration[Any]:
    """The calibration of a table.

    Raises:
        ValueError: If it does not hold together.
    """
    own = {name: value for name, value in table.items() if name not in ("kind", "solution")}
    own["places"] = {name if isinstance(name, str) else tuple(name): slice(*ends) for name, *ends in own["places"]}
    own |= {"status": Status(own["status"]), "labels": tuple(own["labels"]), "hardly_seen": tuple(own["hardly_seen"])}
    own["unknown"] = tuple(own.get("unknown", ()))
    own["odd"] = Odd(**own["odd"] | {"shapes": tuple(own["odd"]["shapes"])}) if own.get("odd") else None
    found = Fitted(**own)
    if not len(found.values) == len(found.labels) == len(found.covariance):
        raise ValueError(f"{where}{len(found.values)} values do not go with {len(found.labels)} labels")
    return Calibration(result_from(table["solution"], f"{where}solution."), found)
