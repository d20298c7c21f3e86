"""g-sensitivity of gyros and quadratic terms of accelerometers from a tumble in the gravity field.

    gyro:  y_i = b_i + sum M_ij w_j + sum G_ij f_j [+ sum Q_ij f_j^2],    w = stand + Earth, in body axes
    acc:   y_i = b_i + sum M_ij f_j + K2_i f_i^2

Turning about a horizontal axis makes the specific force a harmonic of the angle, and the Earth rate across
the spin axis one of the same order: with a spin axis to the north it has the very phase of g. Where it is
left out, Omega sin(latitude) / g is taken for g-sensitivity: 9.7 deg/h per g at 40 deg. So attitude and
latitude are arguments without defaults, and what they may be off goes into the covariance.

Rates of the stand that are large carry columns of M themselves; where a body axis turns with the Earth only,
its column is taken as stated (`matrix`) and its doubt is in the covariance.

In a slow tumble f_x^2 + f_y^2 + f_z^2 = g^2 is constant: the sum of the three quadratic terms is a bias, and
only differences are told (`f_x^2 - f_z^2`, `f_y^2 - f_z^2`). IEEE 952 (g- and g^2-sensitivity), IEEE 1293
(K2).
"""

# pyright: strict
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from calibration.algorithms.block_means import BlockRecord, block_means, joined
from calibration.algorithms.correlated_fit import (
    Blocks,
    CorrelatedFit,
    FloatArray,
    SlowTerms,
    fit_correlated,
    refused,
)
from calibration.algorithms.earth import earth_rate_ned
from calibration.algorithms.screening import NotUsed

MIN_STAND_RATE_RAD_S = 0.02
"""A body axis that the stand turns faster than this carries its own column of M."""
MAX_BLOCK_ANGLE_RAD = 0.35
"""Terms are averaged inside a block as the outputs are; more than 20 deg would lose their second harmonic."""
MATRIX_DOUBT = 5e-3
"""Standard uncertainty of each element of M that nobody states."""
BLOCKS = 200.0


@dataclass(frozen=True)
class TumbleRun:
    """A stretch without gaps in the stand's recording; all on one clock.

    Attributes:
        name: for the record.
        time_s: shape (n,).
        output: of the triad, shape (n, 3), SI.
        rate_body_rad_s: of the stand relative to the laboratory, shape (n, 3).
        dcm_body_from_ned: attitude against north, east, down, shape (n, 3, 3).
    """

    name: str
    time_s: FloatArray
    output: FloatArray
    rate_body_rad_s: FloatArray
    dcm_body_from_ned: FloatArray


@dataclass(frozen=True)
class Site:
    """Where the stand is.

    Attributes:
        latitude_rad, gravity_m_s2: of the site.
        heading_standard_uncertainty_rad: of the stand's azimuth: it turns the Earth rate, not g.
    """

    latitude_rad: float
    gravity_m_s2: float
    heading_standard_uncertainty_rad: float = 0.0


@dataclass(frozen=True)
class TumbleFigures:
    """Terms of each sensor of a triad.

    Attributes:
        g_sensitivity: gyros: G, (rad/s)/(m/s^2); accelerometers: M, 1; shape (3, 3), row: sensor.
        quadratic: accelerometers: K2_i, 1/(m/s^2), shape (3, 1). Gyros: differences of Q_ij to Q_iz,
            (rad/s)/(m/s^2)^2, shape (3, 2), or (3, 0) if not asked for.
        bias: shape (3,).
        fits: of each sensor, with all terms, their covariance and condition.
        not_used: samples, why.
        words: what was done with the Earth rate.
    """

    g_sensitivity: FloatArray
    quadratic: FloatArray
    bias: FloatArray
    fits: tuple[CorrelatedFit, ...]
    not_used: tuple[NotUsed, ...]
    words: str

    def standard_uncertainty(self) -> FloatArray:
        """Of `g_sensitivity`, shape (3, 3)."""
        columns = [f"f_{axis}" for axis in "xyz"]
        return np.array([[float(fit.of(name)[1][0]) for name in columns] for fit in self.fits])

    def quadratic_standard_uncertainty(self) -> FloatArray:
        """Of `quadratic`, the same shape."""
        names = [[name for name in fit.names if "^2" in name] for fit in self.fits]
        doubts = [
            [float(fit.of(name)[1][0]) for name in own] for fit, own in zip(self.fits, names, strict=True)
        ]
        return np.array(doubts).reshape(self.quadratic.shape)


def gyro_g_sensitivity(
    runs: Sequence[TumbleRun],
    site: Site,
    *,
    matrix: FloatArray | None = None,
    quadratic: bool = False,
    range_rad_s: float | None = None,
    known_slow: SlowTerms | None = None,
    where: str = "g-sensitivity",
) -> TumbleFigures:
    """G of three gyros.

    Args:
        runs: tumbles about two or more horizontal axes, rests with them.
        site: of the stand.
        matrix: M of the gyros from another test; None: the identity to `MATRIX_DOUBT`.
        quadratic: whether to look for differences of g^2 terms.
        range_rad_s: blocks with saturated samples are left out.
        known_slow: see `correlated_fit`.
        where: for errors.

    Raises:
        CalibrationError: an axis that gravity never acts along, or too little data.
    """
    record = _observe(runs, site, range_rad_s, where)
    stand, earth, force, squares, across = np.split(record.inputs, [3, 6, 9, 12], axis=1)
    known = np.eye(3) if matrix is None else np.asarray(matrix, dtype=np.float64)
    turning = np.flatnonzero(np.abs(stand).max(axis=0) > MIN_STAND_RATE_RAD_S)
    resting = [axis for axis in range(3) if axis not in turning]
    columns = [np.ones(len(force)), *force.T, *(stand + earth)[:, turning].T]
    names = ["bias", *(f"f_{axis}" for axis in "xyz"), *(f"rate_{'xyz'[axis]}" for axis in turning)]
    if quadratic:
        columns += [squares[:, 0] - squares[:, 2], squares[:, 1] - squares[:, 2]]
        names += ["f_x^2 - f_z^2", "f_y^2 - f_z^2"]
    design = np.column_stack(columns)
    doubt = 0.0 if matrix is not None else MATRIX_DOUBT
    off = [earth[:, axis] * doubt for axis in resting]
    off += [across[:, axis] * site.heading_standard_uncertainty_rad for axis in range(3)]
    fits: list[CorrelatedFit] = []
    for gyro in range(3):
        blocks = record.blocks
        rest = (stand + earth)[:, resting] @ known[gyro, resting]
        own = Blocks(blocks.middle_s, blocks.duration_s, (blocks.means[:, gyro] - rest)[:, None])
        weight = np.array([1.0] * len(resting) + [known[gyro, axis] for axis in range(3)])
        # The heading is one influence on all axes; a column's doubt is one for each.
        heading = (np.array(off[len(resting) :]).T @ weight[len(resting) :])[:, None]
        systematic = np.column_stack([*off[: len(resting)], heading])[:, :, None]
        fits.append(_fit(design, own, names, f"{where}, gyro {'xyz'[gyro]}", known_slow, systematic))
    told = f"Earth rate at {np.degrees(site.latitude_rad):.4g} deg latitude taken out, attitude by attitude"
    return _figures(fits, record, [name for name in names if "^2" in name], told)


def accelerometer_quadratic(
    runs: Sequence[TumbleRun],
    site: Site,
    *,
    range_m_s2: float | None = None,
    known_slow: SlowTerms | None = None,
    where: str = "accelerometer tumble",
) -> TumbleFigures:
    """M, bias and K2 of three accelerometers (IEEE 1293); the Earth rate has no part in it.

    The centripetal part of a slow tumble, w^2 r, is 0.1 mm/s^2 at 12 deg/s and 2 mm; hold the unit near the
    axes' crossing, or tumble slower.

    Raises:
        CalibrationError: as `gyro_g_sensitivity`.
    """
    record = _observe(runs, site, range_m_s2, where)
    force, squares = record.inputs[:, 6:9], record.inputs[:, 9:12]
    fits: list[CorrelatedFit] = []
    for sensor in range(3):
        blocks = record.blocks
        own = Blocks(blocks.middle_s, blocks.duration_s, blocks.means[:, sensor : sensor + 1])
        design = np.column_stack([np.ones(len(force)), force, squares[:, sensor]])
        names = ("bias", "f_x", "f_y", "f_z", f"f_{'xyz'[sensor]}^2")
        fits.append(_fit(design, own, names, f"{where}, sensor {'xyz'[sensor]}", known_slow))
    return _figures(fits, record, None, "Earth rate does not act on accelerometers; gravity holds its part")


def _fit(
    design: FloatArray,
    own: Blocks,
    names: Sequence[str],
    where: str,
    known_slow: SlowTerms | None,
    systematic: FloatArray | None = None,
) -> CorrelatedFit:
    """One sensor's; where nobody states the slow noise, intervals of all terms but the bias are widened.

    A wander of a third of the record is seen in part only, and at the frequency of the tumble it is several
    times the white noise: the likelihood alone leaves the truth outside of one interval in ten.
    """
    fit = fit_correlated(design, own, names, where, known_slow, systematic)
    if known_slow is not None:
        return fit
    wide = fit_correlated(design, own, names, where, None, systematic, cautious=True)
    ratio = np.maximum(wide.standard_uncertainty / fit.standard_uncertainty, 1.0)
    ratio[:, list(names).index("bias")] = 1.0
    return replace(fit, covariance=fit.covariance * ratio[:, :, None] * ratio[:, None, :])


def _observe(runs: Sequence[TumbleRun], site: Site, limit: float | None, where: str) -> BlockRecord:
    """Blocks with the means of stand rate, Earth rate, f, f^2 and the Earth rate's change by the heading."""
    if not runs:
        raise refused("There is no run.", where, "hand over at least one tumble.")
    fastest = max(float(np.linalg.norm(run.rate_body_rad_s, axis=1).max(initial=0.0)) for run in runs)
    duration_s = sum(float(run.time_s[-1] - run.time_s[0]) for run in runs)
    block_s = max(duration_s / BLOCKS, 4.5 * float(np.median(np.diff(runs[0].time_s))))
    if fastest * block_s > MAX_BLOCK_ANGLE_RAD:
        raise refused(
            f"The stand turns {np.degrees(fastest * block_s):.3g} deg in a block of {block_s:.3g} s.",
            where,
            "tumble slower, sample faster, or hand over fewer runs at once.",
        )
    earth_ned = earth_rate_ned(site.latitude_rad)
    turned_ned = np.array([-earth_ned[1], earth_ned[0], 0.0])
    records: list[BlockRecord] = []
    for run in runs:
        force = run.dcm_body_from_ned @ np.array([0.0, 0.0, -site.gravity_m_s2])
        earth, across = run.dcm_body_from_ned @ earth_ned, run.dcm_body_from_ned @ turned_ned
        inputs = np.concatenate([run.rate_body_rad_s, earth, force, force**2, across], axis=1)
        usable = np.flatnonzero(~np.isnan(np.column_stack([run.output, inputs]).sum(axis=1)))
        expected = _rough(inputs[:, [0, 1, 2, 6, 7, 8]], run.output, usable)
        records.append(
            block_means(
                run.name,
                run.time_s,
                run.output,
                block_s,
                inputs=inputs,
                range_limit=limit,
                expected=expected,
            )
        )
    return joined(records)


def _rough(inputs: FloatArray, output: FloatArray, usable: NDArray[np.intp]) -> FloatArray:
    """What the motion explains of the outputs, so that outliers are looked for in the rest."""
    design = np.column_stack([np.ones(len(inputs)), np.nan_to_num(inputs)])
    values = np.asarray(np.linalg.pinv(design[usable]), dtype=np.float64) @ output[usable]
    return design @ values


def _figures(
    fits: list[CorrelatedFit], record: BlockRecord, squares: list[str] | None, words: str
) -> TumbleFigures:
    def term(fit: CorrelatedFit, name: str) -> float:
        return float(fit.of(name)[0][0])

    own = [squares if squares is not None else [fit.names[-1]] for fit in fits]
    quadratic = [[term(fit, name) for name in names] for fit, names in zip(fits, own, strict=True)]
    return TumbleFigures(
        g_sensitivity=np.array([[term(fit, f"f_{axis}") for axis in "xyz"] for fit in fits]),
        quadratic=np.array(quadratic).reshape(len(fits), -1),
        bias=np.array([term(fit, "bias") for fit in fits]),
        fits=tuple(fits),
        not_used=record.not_used,
        words=words,
    )
