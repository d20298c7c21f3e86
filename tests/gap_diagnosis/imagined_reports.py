"""Gap reports of all four verdicts, as a diagnosis would hand them back; the figures are made up."""

import itertools
from typing import Any

import numpy as np

from gap_diagnosis.report import GapReport, HeatCell, ResidualSeries, Spectrum
from gap_diagnosis.report_document import ReportDocument, parse_report, report_text

DEG = np.pi / 180
G_PARAMETER = {"acc_xy": {"value": 0.00402, "standard_uncertainty": 0.00031, "unit": "deg/s per g"}}
EVEN_PARAMETER = {"square_x": {"value": 2.1e-4, "standard_uncertainty": 1.7e-5, "unit": "1 per rad/s"}}


def g_sensitivity(probability: float) -> dict[str, Any]:
    return {
        "effect": "gyro.g_sensitivity",
        "sensor": "gyro",
        "probability": probability,
        "channels": ["gyro_x"],
        "parameters": G_PARAMETER,
        "confusable_with": ["gyro.even_nonlinearity"],
    }


def even(probability: float) -> dict[str, Any]:
    return {
        "effect": "gyro.even_nonlinearity",
        "sensor": "gyro",
        "probability": probability,
        "channels": ["gyro_x"],
        "parameters": EVEN_PARAMETER,
        "confusable_with": ["gyro.g_sensitivity"],
    }


def where() -> list[dict[str, Any]]:
    return [
        {
            "channel": "gyro_x",
            "kind": "deterministic",
            "regime": {"variable": "specific_force", "low": 0.5, "high": 1.0, "unit": "g"},
            "p_adjusted": 2e-5,
            "fitted_tail": True,
            "excess_rms": 0.0039,
            "unit": "deg/s",
        },
        {
            "channel": "gyro_x",
            "kind": "deterministic",
            "regime": {"variable": "rate", "low": -300, "high": -100, "unit": "deg/s"},
            "p_adjusted": 0.008,
            "excess_rms": 0.0012,
            "unit": "deg/s",
        },
    ]


def shrinkage(after: float, closed: float) -> dict[str, Any]:
    return {
        "held_out": ["run 2"],
        "before": 4.1,
        "after": after,
        "noise_floor": 1.0,
        "unit": "1 (whitened rms)",
        "fraction_closed": closed,
        "ci95": [closed - 0.005, min(closed + 0.002, 1.0)],
        "channels": {
            "gyro_x": {"before": 0.0142, "after": 0.0006, "unit": "deg/s"},
            "gyro_y": {"before": 0.0021, "after": 0.0020, "unit": "deg/s"},
        },
    }


NEXT = {
    "profile": "tumble",
    "values": {"spin_deg_s": 100.0},
    "minutes": 2.1,
    "expected_bits": 0.83,
    "separates": ["gyro.g_sensitivity", "gyro.even_nonlinearity"],
    "ranked": [
        {"profile": "tumble", "values": {"spin_deg_s": 100.0}, "minutes": 2.1, "expected_bits": 0.83},
        {"profile": "multi_position", "minutes": 3.0, "expected_bits": 0.7},
        {"profile": "static", "minutes": 2.0, "expected_bits": 0.01},
    ],
}


def document(verdict: str) -> dict[str, Any]:
    base: dict[str, Any] = {
        "format": "testloom-gap-report/1",
        "verdict": verdict,
        "where": where(),
        "which": [],
        "sets": [],
        "class_probability": None,
        "shrinkage": None,
        "unattributed": {"p": 0.4, "description": None},
        "next_test": None,
        "product": "mems_ahrs",
        "recordings": [
            {"recording_id": f"mems_ahrs-U-0007-swing-m1-r{run}", "sha256": f"{run}" * 64, "serial": "U-0007"}
            | {"profile": "swing"}
            for run in (1, 2)
        ],
    }
    match verdict:
        case "no_gap":
            return base | {"where": [], "sets": [{"effects": [], "probability": 0.97}]}
        case "attributed":
            return base | {
                "which": [g_sensitivity(0.981), even(0.012)],
                "sets": [
                    {"effects": ["gyro.g_sensitivity"], "probability": 0.975},
                    {"effects": ["gyro.even_nonlinearity"], "probability": 0.012},
                    {"effects": [], "probability": 0.0001},
                ],
                "class_probability": 0.99,
                "shrinkage": shrinkage(1.03, 0.9962),
                "next_test": NEXT,
            }
        case "confusable":
            return base | {
                "which": [g_sensitivity(0.62), even(0.37)],
                "sets": [
                    {"effects": ["gyro.g_sensitivity"], "probability": 0.62},
                    {"effects": ["gyro.even_nonlinearity"], "probability": 0.37},
                    {"effects": ["gyro.even_nonlinearity", "stand.lever_arm"], "probability": 0.004},
                ],
                "class_probability": 0.99,
                "shrinkage": shrinkage(1.05, 0.991),
                "next_test": NEXT,
            }
        case _:
            return base | {
                "which": [even(0.31), g_sensitivity(0.22)],
                "sets": [{"effects": ["gyro.even_nonlinearity"], "probability": 0.31}],
                "shrinkage": shrinkage(2.6, 0.61),
                "unattributed": {"p": 0.001, "description": "A line at 12.4 Hz is left on gyro_x."},
            }


def report(verdict: str) -> GapReport:
    """With pictures of two channels and a map of three variables."""
    rng = np.random.default_rng(3)
    time = np.arange(0.0, 120.0, 0.06)
    wave = 0.014 * np.sin(2 * np.pi * time / 20)
    heat = tuple(
        HeatCell(channel, variable, low, high, unit, sigmas, 0.001 if sigmas > 5 else 0.6)
        for channel, gain in (("gyro_x", 1.0), ("gyro_y", 0.1), ("gyro_z", 0.0), ("acc_x", 0.2))
        for variable, unit, edges in (
            ("temperature", "degC", (20.0, 25.0, 30.0)),
            ("rate", "deg/s", (-300.0, -100.0, 0.0, 100.0, 300.0)),
            ("specific_force", "g", (-1.0, -0.5, 0.0, 0.5, 1.0)),
        )
        for low, high, sigmas in (
            (a, b, gain * abs(a + b) * 9 / (abs(edges[0]) + 50) + 0.8) for a, b in itertools.pairwise(edges)
        )
    )
    series = tuple(
        ResidualSeries(
            f"mems_ahrs-U-0007-swing-m1-r{run}",
            channel,
            "deg/s",
            time,
            gain * wave + rng.normal(0, 0.004, time.size),
            rng.normal(0, 0.004, time.size),
        )
        for run in (1, 2)
        for channel, gain in (("gyro_x", 1.0), ("gyro_y", 0.1))
    )
    taus = np.geomspace(0.06, 40.0, 30)
    white = 0.001 / np.sqrt(taus)
    frequencies = np.geomspace(0.01, 8.0, 60)
    spectra = (
        Spectrum("gyro_x", "allan", "deg/s", taus, white + 0.004 * taus / 10, 1.02 * white, white),
        Spectrum(
            "gyro_x",
            "psd",
            "deg/s/sqrt(Hz)",
            frequencies,
            1e-3 + 1e-4 / frequencies,
            np.full(60, 1.02e-3),
            np.full(60, 1e-3),
        ),
    )
    sentences = ("40 samples of gyro_y were saturated.",)
    return GapReport(document(verdict), (), heat, series, spectra, sentences)


def parsed(verdict: str) -> ReportDocument:
    return parse_report(report_text(document(verdict)))
