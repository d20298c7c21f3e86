"""Acceptance of an overload rig, and the number of shots, by their commands."""

import json
import math
from pathlib import Path

import numpy as np
import pytest

from calibration.algorithms.overload_acceptance import guide_angle, run_figures
from cli.main import main
from dut_emulator.recording.recorder import recorded
from protocol.errors import CalibrationError
from protocol.folder_form import write_folder

ARC_SECOND = math.radians(1 / 3600)


def run_up(overload_g: float, start_s: float, hold_s: float) -> tuple[np.ndarray, np.ndarray]:
    """Rest for 2 s, constant angular acceleration for `start_s`, then an even speed; crank of 0.15 m."""
    speed = math.sqrt(overload_g * 9.80665 / 0.15)
    time_s = np.arange(0.0, 2.0 + start_s + hold_s, 1e-3)
    since = np.clip(time_s - 2.0, 0.0, None)
    turned = np.where(since < start_s, 0.5 * speed / start_s * since**2, speed * (since - 0.5 * start_s))
    return time_s, 0.15 * np.cos(turned)


@pytest.mark.parametrize("overload_g", range(1, 13))
def test_start_up_and_peak_of_a_run_from_rest(overload_g: int) -> None:
    found = run_figures(*run_up(overload_g, 12.0, 30.0))
    period_s = 2 * math.pi / math.sqrt(overload_g * 9.80665 / 0.15)
    assert found.overload_g == pytest.approx(overload_g, rel=1e-4)
    assert found.start_up_s is not None
    # there once a whole cycle is within 1 %: the speed to 0.5 %, give or take a cycle
    assert abs(found.start_up_s - 0.995 * 12.0) < 1.5 * period_s + 0.3
    assert found.at_peak_s == pytest.approx(30.0, abs=2 * period_s + 0.1)
    assert found.unevenness < 5e-3


def test_angles_of_the_guide() -> None:
    rng = np.random.default_rng(3)
    position = np.linspace(-0.15, 0.15, 31)
    angle = ARC_SECOND * (7.0 + 4.0 * position / 0.15)
    found = guide_angle(position, angle)
    assert found.span_rad == pytest.approx(8.0 * ARC_SECOND)
    assert abs(found.largest_rad) == pytest.approx(4.0 * ARC_SECOND)
    assert abs(found.at_m) == pytest.approx(0.15)
    assert found.gravity_m_s2 == pytest.approx(9.80665 * 4.0 * ARC_SECOND)
    for broken, words in (
        ((position[:20], angle[:20]), "20 points of the stroke"),
        ((np.r_[position[:16], position[16:] + 0.2], angle), "has no point"),
        ((position, np.where(rng.random(31) < 0.1, np.nan, angle)), "missing"),
    ):
        with pytest.raises(CalibrationError, match=words):
            guide_angle(*broken)
    with pytest.raises(CalibrationError, match="cycles"):
        run_figures(np.arange(0.0, 1.0, 1e-3), np.zeros(1000))


def test_the_commands(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    values = {"overload_g": 3.0, "cycles": 6.0, "axis": 1.0}
    write_folder(recorded("pulse_imu", "overload", values=values), tmp_path / "run")
    points = "\n".join(f"{x:.4f},{20 * x:.3f},{-10 * x:.3f}" for x in np.linspace(-0.15, 0.15, 30))
    (tmp_path / "guide.csv").write_text(f"position_m,pitch_arcsec,roll_arcsec\n{points}\n")
    asked = ["calibrate", "rig", str(tmp_path / "run"), "--guide", str(tmp_path / "guide.csv")]
    assert main([*asked, "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["runs"][0]["overload_g"] == pytest.approx(3.0, rel=1e-3)
    assert told["runs"][0]["start_up_s"] is None
    assert told["guide"]["pitch"]["span_rad"] == pytest.approx(6.0 * ARC_SECOND, rel=1e-6)
    assert main(asked) == 0
    assert "start-up not recorded" in capsys.readouterr().out
    (tmp_path / "guide.csv").write_text("a,b\n1,2\n")
    assert main(asked) != 0
    assert "columns position_m" in capsys.readouterr().err
    assert main(["calibrate", "shots", "--precision", "25", "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert (facts["half_width"], facts["mid_point"], facts["programmed"], facts["as_printed"]) == (
        64,
        44,
        5,
        31,
    )
    assert facts["as_printed_truly_reaches"] == pytest.approx(0.830435367)
