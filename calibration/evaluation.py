"""What an evaluation of recordings hands back, whatever method was used."""

from dataclasses import dataclass
from typing import Literal

from calibration.algorithms.coefficients import FloatArray, TriadCoefficients
from calibration.algorithms.screening import NotUsed

Method = Literal["imu_calibration", "ferraris", "multi_position"]


@dataclass(frozen=True)
class GyroBias:
    """The gyro's mean output at rest where nothing turned: shapes (3,), rad/s."""

    bias_rad_s: FloatArray
    standard_uncertainty_rad_s: FloatArray
    degrees_of_freedom: int


@dataclass(frozen=True)
class Residual:
    """What the model leaves of one pose or turn. `values`: one per axis, or the norm alone."""

    name: str
    values: tuple[float, ...]
    unit: str


@dataclass(frozen=True)
class Evaluation:
    """Coefficients from recordings, and what they rest on.

    Attributes:
        recording_ids: evaluated together.
        serial, product: of the unit.
        method: chosen from the recordings' profiles and streams.
        acc, gyro: None where the recordings cannot carry them (see `not_used`).
        gyro_bias: where there are rests but no turns.
        residuals: per pose and turn.
        assumptions: sentences for people: gravity, frames, alignment, noise.
        not_used: what, how many samples, why.
    """

    recording_ids: tuple[str, ...]
    serial: str
    product: str
    method: Method
    acc: TriadCoefficients | None
    gyro: TriadCoefficients | None
    gyro_bias: GyroBias | None
    residuals: tuple[Residual, ...]
    assumptions: tuple[str, ...]
    not_used: tuple[NotUsed, ...]
