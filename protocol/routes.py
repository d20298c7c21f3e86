"""Routes: the operations that a product's units pass, and what a failure leads to."""

from pydantic import Field

from protocol.frozen_model import FrozenModel
from protocol.outcomes import Disposition


class Operation(FrozenModel):
    """One operation of a route.

    `max_attempts_failed`: unit-fault failures after which the unit leaves the line
    (2 = retest once, on another socket when there is one).
    `max_attempts_disturbed`: attempts lost to station, stand or fixture before the unit is set
    aside: it cannot be judged. `deadline_s`: wall time that a leased attempt may take.
    """

    name: str
    max_attempts_failed: int = Field(default=2, ge=1, le=10)
    max_attempts_disturbed: int = Field(default=5, ge=1, le=100)
    deadline_s: float = Field(default=600.0, gt=0)
    on_confirmed_failure: Disposition = Disposition.SCRAP
    on_unjudgeable: Disposition = Disposition.QUARANTINE


class Route(FrozenModel):
    """The operations of a product in their order."""

    name: str
    product: str
    operations: tuple[Operation, ...] = Field(min_length=1, max_length=32)


GNC_MODULE_ROUTE = Route(
    name="gnc_module",
    product="gnc_module",
    # The stacked package cannot be opened again (paper 1, section 1): a confirmed failure is scrap.
    operations=(Operation(name="functional"), Operation(name="imu_calibration")),
)
"""The demonstration route: functional test, then IMU calibration on a three-axis turntable."""

ROUTES = {GNC_MODULE_ROUTE.name: GNC_MODULE_ROUTE}
