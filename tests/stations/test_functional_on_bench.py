"""The functional plan on an emulated bench: good units, bad units, bad links, aborts, a dead bench."""

import threading

import pytest

from dut_emulator.products.gnc_module.defects import DEFECTS
from dut_emulator.products.gnc_module.population import draw_unit
from dut_emulator.products.gnc_module.unit_truth import Category
from protocol.bench_control import Insert
from protocol.errors import Fault
from protocol.measurements import MeasurementOutcome
from protocol.outcomes import Outcome
from stations.drivers.arbitration import Arbitration
from stations.drivers.control_channel import ControlChannel
from stations.drivers.scpi import ScpiSession
from stations.interruptions import AbortFlag
from stations.sequencing.runner import SequenceResult, SequenceRunner
from stations.sequencing.step_registry import bundled_plans

from .conftest import SEED, Floor, lease_of

SERIALS = [f"GNC-{number:05d}" for number in range(3000)]
MAX_FUNCTIONAL_BENCH_S = 7.0
SEEN_ON_THE_STAND_ONLY = {"gyro_scale", "acc_bias"}

MEASUREMENT_OF_DEFECT = {
    "open_pin": "continuity_",
    "shorted_pin": "insulation_",
    "shorted_rail": "impedance_",
    "high_impedance_rail": "impedance_",
    "weak_rail": "rail_",
    "excess_ripple": "ripple_5v",
    "high_supply_current": "supply_current",
    "slow_timer": "timer_period_error_",
    "gyro_bias": "gyro_bias_",
    "noisy_gyro": "gyro_noise_",
    "dead_gyro_axis": "gyro_noise_",
    "ad_error": "ad_error_",
    "ad_channel_off": "ad_error_",
    "gnss_position": "gnss_position_error",
    "no_gnss_fix": "gnss_fix",
    "bad_memory_cell": "_words_wrong",
    "silent_can": "can_",
    "io_stuck": "io_patterns_wrong",
    "spi_broken": "spi_bytes_wrong",
}


def serial_of(category: Category, defect: str | None = None, but: str = "") -> str:
    for serial in SERIALS:
        truth = draw_unit(SEED, serial)
        if truth.category is category and truth.defect == defect and serial != but:
            return serial
    raise AssertionError(f"no {category} unit with {defect} among {len(SERIALS)}")


HEALTHY = serial_of(Category.HEALTHY)


def test_every_kind_of_defect_is_looked_for():
    assert set(MEASUREMENT_OF_DEFECT) | SEEN_ON_THE_STAND_ONLY == {kind.name for kind in DEFECTS}


def failed_measurements(result: SequenceResult) -> list[str]:
    return [
        measurement.specification.name
        for step in result.steps
        for measurement in step.measurements
        if measurement.outcome is MeasurementOutcome.FAIL
    ]


def test_a_healthy_unit_passes_in_time(floor: Floor):
    result = floor.run(HEALTHY)
    assert (result.outcome, result.fault, result.message) == (Outcome.PASS, Fault.NONE, "")
    assert result.safe_state
    assert result.duration_bench_s < MAX_FUNCTIONAL_BENCH_S
    plan = bundled_plans()["functional"]
    declared = {m.name for step in plan.steps() for m in step.measurements}
    assert {m.specification.name for step in result.steps for m in step.measurements} == declared


def test_lock_step_repeats_itself(floor: Floor):
    first, second = floor.run(HEALTHY), floor.run(HEALTHY)
    assert first.duration_bench_s == pytest.approx(second.duration_bench_s, abs=1e-9)
    assert [step.step for step in first.steps if step.branch == 0] == [
        step.step for step in second.steps if step.branch == 0
    ]


@pytest.mark.parametrize("defect", sorted(MEASUREMENT_OF_DEFECT))
def test_a_defect_fails_where_it_is(floor: Floor, defect: str):
    result = floor.run(serial_of(Category.GROSS, defect))
    assert (result.outcome, result.fault) == (Outcome.FAIL, Fault.UNIT)
    failed = failed_measurements(result)
    assert any(MEASUREMENT_OF_DEFECT[defect] in name for name in failed), failed
    assert result.safe_state


def test_a_shorted_rail_is_never_powered(floor: Floor):
    result = floor.run(serial_of(Category.GROSS, "shorted_rail"))
    assert "power_up" not in [step.step for step in result.steps]
    assert [step.step for step in result.steps[-2:]] == ["power_down", "remove_unit"]


@pytest.mark.parametrize(
    ("fault", "outcome", "blamed"),
    [
        # nothing comes: the fixture's own signs are good, so it is the unit that does not answer
        ("stuck", Outcome.ERROR, Fault.UNIT),
        # damage in transit: the fixture's
        ("corrupt_crc", Outcome.ERROR, Fault.FIXTURE),
        # frames are found behind the noise
        ("garbage", Outcome.PASS, Fault.NONE),
    ],
)
def test_a_bad_link_ends_in_its_own_way(floor: Floor, fault: str, outcome: Outcome, blamed: Fault):
    floor.bench.inject("1.rs422", fault)
    try:
        result = floor.run(HEALTHY)
    finally:
        floor.bench.inject("1.rs422", "none")
    assert (result.outcome, result.fault) == (outcome, blamed), result.message
    assert result.safe_state
    if fault == "garbage":
        (dropped,) = [
            m.value
            for s in result.steps
            for m in s.measurements
            if m.specification.name == "rs422_bytes_dropped"
        ]
        assert isinstance(dropped, (int, float))
        assert dropped > 0


def test_lost_frames_never_hang_and_never_fail_a_good_unit(floor: Floor):
    floor.bench.inject("1.rs422", "drop")
    try:
        result = floor.run(HEALTHY)
    finally:
        floor.bench.inject("1.rs422", "none")
    assert result.outcome in (Outcome.PASS, Outcome.ERROR)
    assert not failed_measurements(result)
    assert result.safe_state


def test_another_unit_in_the_socket_is_the_operators_fault(floor: Floor):
    plan = bundled_plans()["functional"]
    runner = floor.runners["1"]
    inserted = runner._bench._handler.insert  # the hand takes the wrong unit
    other = serial_of(Category.HEALTHY, but=HEALTHY)
    runner._bench._handler.insert = lambda serial: inserted(other)  # type: ignore[method-assign]
    try:
        result = runner.run(plan, lease_of(plan, HEALTHY), lambda progress: None, AbortFlag())
    finally:
        del runner._bench._handler.insert
    assert (result.outcome, result.fault) == (Outcome.ERROR, Fault.OPERATOR)
    assert other in result.message
    assert HEALTHY in result.message


def test_an_abort_ends_in_the_safe_state(floor: Floor):
    abort = AbortFlag()

    def abort_at_boot(progress) -> None:
        if progress.step == "boot_and_identify":
            abort.request("the coordinator revoked the lease")

    result = floor.run(HEALTHY, abort=abort, on_progress=abort_at_boot)
    assert result.outcome is Outcome.ABORTED
    assert "the coordinator revoked the lease" in result.message
    assert [step.step for step in result.steps[-2:]] == ["power_down", "remove_unit"]
    assert result.safe_state
    assert floor.run(HEALTHY).outcome is Outcome.PASS


def test_the_plans_deadline_is_kept(floor: Floor):
    plan = bundled_plans()["functional"].model_copy(update={"deadline_s": 2.0})
    result = floor.run(HEALTHY, plan)
    assert result.outcome is Outcome.TIMEOUT
    assert result.duration_bench_s == pytest.approx(2.0, abs=0.1)
    assert result.safe_state


def test_two_sockets_share_the_instruments_and_bench_time(floor: Floor):
    results: dict[str, SequenceResult] = {}

    def run(socket: str, serial: str) -> None:
        results[socket] = floor.run(serial, socket=socket)

    second = serial_of(Category.HEALTHY, but=HEALTHY)
    threads = [threading.Thread(target=run, args=pair) for pair in (("1", HEALTHY), ("2", second))]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(60)
    assert {socket: result.outcome for socket, result in results.items()} == {
        "1": Outcome.PASS,
        "2": Outcome.PASS,
    }, {socket: result.message for socket, result in results.items()}
    assert max(result.duration_bench_s for result in results.values()) < 2 * MAX_FUNCTIONAL_BENCH_S


def test_what_a_killed_station_left_behind_is_cleared(floor: Floor):
    """A unit under power in socket 1, the relays of socket 2 closed, nobody at work."""
    description = floor.bench.description
    supply = ScpiSession(description.power_supply, "power supply")
    board = ScpiSession(description.sockets[1].board or "", "board")
    control = ControlChannel(description.control or "", "killed", observer=True)
    control.request(Insert(socket="1", serial="LEFT-1"))
    for command in ("VOLT 5,(@1)", "CURR 1,(@1)", "OUTP ON,(@1)"):
        supply.set(command)
    board.set("ROUT:CLOS (@GND_1,GND_2)")
    restarted = SequenceRunner(description, "1", Arbitration(description), floor.folder)
    assert restarted.make_safe().reached
    assert supply.query("OUTP? (@1)") == "0"
    plan = bundled_plans()["functional"]
    result = restarted.run(plan, lease_of(plan, HEALTHY), lambda progress: None, AbortFlag())
    for session in (supply, board, control, restarted):
        session.close()
    assert result.outcome is Outcome.PASS, result.message


@pytest.mark.fabric
def test_a_bench_that_dies_in_mid_step_leaves_a_record(bench_process, tmp_path):
    process, description = bench_process
    runner = SequenceRunner(description, "1", Arbitration(description), tmp_path)
    plan = bundled_plans()["functional"]

    def kill_in_the_middle(progress) -> None:
        if progress.step == "test_cpu" or progress.steps_done == 9:
            process.kill()
            process.wait()

    result = runner.run(plan, lease_of(plan, HEALTHY), kill_in_the_middle, AbortFlag())
    runner.close()
    assert (result.outcome, result.fault) == (Outcome.ERROR, Fault.STATION)
    assert not result.safe_state
    assert "safe state was not reached" in result.message
    assert [step.step for step in result.steps[-2:]] == ["power_down", "remove_unit"]


def test_a_bench_that_is_not_there_leaves_a_record_too(floor: Floor, tmp_path, free_port):
    plan = bundled_plans()["functional"]
    nowhere = f"TCPIP::127.0.0.1::{free_port}::SOCKET"
    description = floor.bench.description.model_copy(
        update={"control": f"127.0.0.1:{free_port}", "power_supply": nowhere}
    )
    runner = SequenceRunner(description, "1", Arbitration(description), tmp_path)
    result = runner.run(plan, lease_of(plan, HEALTHY), lambda progress: None, AbortFlag())
    runner.close()
    assert (result.outcome, result.fault) == (Outcome.ERROR, Fault.STATION)
    assert not result.safe_state
    assert result.steps
