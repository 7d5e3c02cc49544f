"""What is known of numbers before anything is measured. Numbers in parentheses: ``docs/estimation.md``."""

import numpy as np

from multirod.batch import IntArray, take
from multirod.types import Numbers
from multirod.validation import LARGEST, SMALLEST, Described, FloatArray, array, first_of, refuse, shown, unsure

SYMMETRIC = 1e-9  # what a covariance may be off its transpose, of its largest entry


class Prior:
    """What is known of an input, or a parameter, before it is estimated: it is normally distributed.

    Args:
        mean: In the unit of what is estimated; a number for all its components, or shape (..., k). By default what the inputs
            say, or the robot.
        sigma: Standard deviations, > 0, a number for all components, or shape (..., k). ``inf``, the default, says that nothing
            is known of it.
        covariance: In place of ``sigma``, shape (..., k, k): such as an earlier estimate's.

    Raises:
        ValueError: If ``sigma`` is not > 0, ``covariance`` is not symmetric and positive definite, both are given, or neither
            beside a mean that is not zero.
    """

    def __init__(self, mean: Numbers | None = None, *, sigma: Numbers | None = None, covariance: Numbers | None = None) -> None:
        self.mean = None if mean is None else array("Prior.mean", mean)
        self.sigma = np.asarray(np.inf) if sigma is None else deviations("Prior.sigma", sigma, infinite=True)
        self.covariance = None if covariance is None else _covariance(covariance)
        if sigma is not None and covariance is not None:
            refuse("Prior.sigma", sigma, "must not be given beside covariance, which says it")
        if sigma is None and covariance is None and self.mean is not None and self.mean.any():
            refuse(
                "Prior.sigma",
                None,
                f"must be given beside mean = {shown(mean)}, how sure that is; a deviation alone is sigma={shown(mean)}, and "
                "sigma=np.inf says that the mean is only where to begin",
            )

    @property
    def batch_shape(self) -> tuple[int, ...]:
        """Leading axes."""
        own = [self.sigma.shape[:-1], () if self.mean is None else self.mean.shape[:-1]]
        return np.broadcast_shapes(*own, () if self.covariance is None else self.covariance.shape[:-2])

    def flat_count(self, name: str, size: int) -> int:
        """Of how many of ``size`` components nothing is known, in some instance."""
        if self.covariance is not None:
            return 0
        return int(np.isinf(_each(f"Prior.sigma of {name}", self.sigma, size)).sum(axis=-1).max())

    def means(self, name: str, like: FloatArray, batch_shape: tuple[int, ...], instances: IntArray | None) -> FloatArray:
        """(b, k) of some instances; ``like`` (..., k) where it says nothing."""
        values = like if self.mean is None else _each(f"Prior.mean of {name}", self.mean, like.shape[-1])
        return np.array(_taken(f"Prior.mean of {name}", values, batch_shape, instances, 1))

    def variances(self, name: str, size: int, batch_shape: tuple[int, ...], instances: IntArray | None) -> FloatArray:
        """Covariances (b, k, k) of some instances, infinite on the diagonal where nothing is known."""
        field = f"Prior of {name}"
        if self.covariance is None:
            sigma = _taken(field, _each(field, self.sigma, size), batch_shape, instances, 1)
            result = np.zeros((len(sigma), size, size))
            result[:, np.arange(size), np.arange(size)] = sigma**2
            return result
        if self.covariance.shape[-1] != size:
            refuse(f"{field}, covariance", Described(f"array of shape {self.covariance.shape}"), f"must be (..., {size}, {size})")
        return np.array(_taken(field, self.covariance, batch_shape, instances, 2))

    def __repr__(self) -> str:
        mean = "" if self.mean is None else f"{self.mean.tolist()}, "
        spread = f"sigma={self.sigma.tolist()}" if self.covariance is None else f"covariance={self.covariance.tolist()}"
        return f"Prior({mean}{spread})"


class Walk:
    """What is known of an input from one sample to the next: it walks at random, from a prior on.

    Args:
        sigma: Standard deviation of what it changes by in a second, in its unit over the root of a second: after a time ``t`` it
            has changed by ``sigma sqrt(t)``. A number > 0 for all components, or shape (..., k).
        start: Of the first sample; by default what the inputs say, give or take ten seconds of the walk.

    Raises:
        TypeError: If ``start`` is not a ``Prior``.
        ValueError: If ``sigma`` is not > 0 and finite.
    """

    def __init__(self, sigma: Numbers, *, start: Prior | None = None) -> None:
        self.sigma = deviations("Walk.sigma", sigma)
        if start is not None and not isinstance(start, Prior):
            raise TypeError(f"Walk.start must be a Prior, not {type(start).__name__}")
        self.start = Prior(sigma=np.sqrt(10.0) * self.sigma) if start is None else start

    def rates(self, name: str, size: int, batch_shape: tuple[int, ...]) -> FloatArray:
        """Variances per second, (b, k)."""
        field = f"Walk.sigma of {name}"
        return np.asarray(_taken(field, _each(field, self.sigma, size), batch_shape, None, 1) ** 2)

    def __repr__(self) -> str:
        return f"Walk({self.sigma.tolist()}, start={self.start!r})"


def deviations(field: str, value: object, *, infinite: bool = False) -> FloatArray:
    """Standard deviations, > 0, of any shape."""
    result = array(field, value, finite=False)
    wrong = ~(result > 0) | ((not infinite) & np.isinf(result))
    if not result.size or wrong.any():
        refuse(field, first_of(wrong, result, value), "must be > 0" + (" (inf: nothing is known)" if infinite else " and finite"))
    if (wrong := unsure(result, infinite=infinite)).any():
        allowed = f"must be from {SMALLEST:g} to {LARGEST:g} in SI units" + (", or inf" if infinite else "")
        refuse(field, first_of(wrong, result, value), allowed)
    return result


def _covariance(value: object) -> FloatArray:
    result = array("Prior.covariance", value)
    if result.ndim < 2 or result.shape[-1] != result.shape[-2] or not result.size:
        refuse("Prior.covariance", Described(f"array of shape {result.shape}"), "must be (..., k, k)")
    twisted = np.abs(result - np.swapaxes(result, -1, -2)).max() > SYMMETRIC * np.abs(result).max()
    if twisted or (np.linalg.eigvalsh(result) <= 0).any():
        refuse("Prior.covariance", value, "must be symmetric and positive definite")
    if unsure(np.sqrt(np.diagonal(result, axis1=-2, axis2=-1))).any():
        refuse("Prior.covariance", value, f"must be of standard deviations from {SMALLEST:g} to {LARGEST:g} in SI units")
    return result


def _each(field: str, values: FloatArray, size: int) -> FloatArray:
    """(..., k): one number is that of all components."""
    if values.ndim == 0:
        return np.broadcast_to(values, (size,))
    if values.shape[-1] != size:
        refuse(field, Described(f"array of shape {values.shape}"), f"must be one number, or shape (..., {size})")
    return values


def _taken(field: str, values: FloatArray, batch_shape: tuple[int, ...], instances: IntArray | None, tail: int) -> FloatArray:
    own = values.shape[: values.ndim - tail]
    try:
        if np.broadcast_shapes(own, batch_shape) != batch_shape:
            raise ValueError
    except ValueError:
        refuse(field, Described(f"leading axes {own}"), f"must broadcast to those of inputs and measurements, {batch_shape}")
    return np.asarray(take(values, batch_shape, instances, tail=tail))
