"""Records as calibrations of the five products leave them, with realistic numbers, made in code."""

from datetime import UTC, date, datetime

import numpy as np

from calibration.algorithms.coefficients import PARAMETER_NAMES
from calibration.certificate.details import CertificateDetails, Party, Tolerance, WorkingStandard
from calibration.records.making import TRIAD_EQUATION, TRIAD_NAMES, covariance_block
from calibration.records.record import LINEAR_TRIAD, CalibrationRecord
from calibration.records.record_parts import (
    CalibratedQuantity,
    CodeVersion,
    Environment,
    Frame,
    Interval,
    LeftOut,
    Model,
    RecordedBudget,
    RecordedBudgetRow,
    RecordTable,
    SourceRecording,
    StandReference,
    TableColumn,
    TemperatureSpan,
)

CODE = CodeVersion(package="testloom 0.1.0", commit="9f8c2d1")
CREATED = datetime(2026, 3, 5, 14, 20, tzinfo=UTC)
MEASURED = datetime(2026, 3, 5, 9, 0, tzinfo=UTC)
ROOM = TemperatureSpan(low_c=22.6, high_c=23.4)


def _recordings(*names: str) -> tuple[SourceRecording, ...]:
    return tuple(
        SourceRecording(recording_id=name, sha256=f"{k + 10:02x}" * 32, form="mcap")
        for k, name in enumerate(names)
    )


def _column(name: str, unit: str, values: object) -> TableColumn:
    return TableColumn(name=name, unit=unit, values=tuple(map(float, np.asarray(values))))


def gnc_module() -> CalibrationRecord:
    """A gyro triad from a session on a three-axis turntable."""
    generator = np.random.default_rng(3)
    root = generator.standard_normal((12, 12)) * 1e-5 + np.diag([4e-5] * 9 + [3e-6] * 3)
    root[:9] *= 0.5
    root[9:] *= 0.2
    covariance = root @ root.T
    values = [1.00213, -0.00087, 0.00151, 0.00042, 0.99874, -0.00119, 0.00095, 0.00063, 1.00067]
    values += [2.41e-4, -8.3e-5, 1.17e-4]
    units = ["1"] * 9 + ["rad/s"] * 3
    quantities = tuple(
        CalibratedQuantity(
            name=name,
            symbol=symbol,
            value=value,
            unit=unit,
            standard_uncertainty=float(np.sqrt(variance)),
            degrees_of_freedom=24.0,
            coverage_factor=2.11,
        )
        for name, symbol, value, unit, variance in zip(
            TRIAD_NAMES, PARAMETER_NAMES, values, units, np.diag(covariance), strict=True
        )
    )
    turns = [f"turn about {axis}, {sign}3 revolutions" for axis in "xyz" for sign in "+-"]
    poses = [f"pose {axis} {way}" for axis in "xyz" for way in ("up", "down")]
    return CalibrationRecord(
        serial="GM-7-0003",
        product="gnc_module",
        sensor="gyro",
        method="imu_calibration",
        model=Model(name=LINEAR_TRIAD, equation=TRIAD_EQUATION),
        quantities=quantities,
        covariance=(covariance_block(TRIAD_NAMES, covariance),),
        tables=(
            RecordTable(
                name="residuals",
                row_names=(*turns, *poses),
                columns=tuple(
                    _column(f"residual_{axis}", "rad/s", generator.normal(0, 3e-6, 12)) for axis in "xyz"
                ),
                note="output less model, mean of each pose or turn",
            ),
        ),
        frames=(
            Frame(
                name="body",
                definition="nominal axes of the unit, as the stand's mounting and encoders give them",
            ),
        ),
        recordings=_recordings("gm-7-0003-imu-calibration-1"),
        stand=StandReference(id="tt-1", kind="three_axis_turntable", calibration_due=date(2026, 9, 30)),
        environment=Environment(
            unit_temperature=TemperatureSpan(low_c=27.31, high_c=28.04),
            stand_temperature=ROOM,
            latitude_deg=34.2,
            gravity_m_s2=9.797,
        ),
        valid_temperature=TemperatureSpan(low_c=27.31, high_c=28.04),
        assumptions=("poses, turns and Earth rate in body axes as the stand's encoders give them",),
        not_used=(
            LeftOut(what="between the segments", count=18240, why="the stand was moving to the next pose"),
        ),
        code=CODE,
        measured_at=MEASURED,
        created_at=CREATED,
    )


RATES_DEG_S = np.linspace(-100.0, 100.0, 11)


def rate_gyro_triad() -> CalibrationRecord:
    """One axis of paper 4's unit: 11 points, three strokes up and three down."""
    generator = np.random.default_rng(4)
    mean = -0.001116 + 0.050698 * RATES_DEG_S + 0.0011 * (RATES_DEG_S / 100) ** 3
    strokes = {
        f"{way}_{k}": np.round(mean + side * 4e-4 + generator.normal(0, 6e-4, 11), 4)
        for k in (1, 2, 3)
        for way, side in (("up", -1), ("down", 1))
    }
    means = np.mean(list(strokes.values()), axis=0)
    residual = means - np.polyval(np.polyfit(RATES_DEG_S, means, 1), RATES_DEG_S)
    sensitivity_unit = "V/(deg/s)"

    def quantity(name: str, symbol: str, value: float, unit: str, u: float) -> CalibratedQuantity:
        return CalibratedQuantity(
            name=name,
            symbol=symbol,
            value=value,
            unit=unit,
            standard_uncertainty=u,
            degrees_of_freedom=9.0,
            coverage_factor=2.32,
        )

    rows = (
        ("repeatability, mean of 6, through the line", 5.0669, "V", 6.1e-4, "t", 0.0815, 55.0),
        ("meter, all points through the line", 0.0, "V", 1.3e-4, "uniform", 0.0986, None),
        ("table rate, all points through the line", 0.0, "V", 2.9e-4, "uniform", -0.0986, None),
        ("full scale Y_FS", 10.1369, "V", 8.6e-4, "normal", -1.2e-5, 55.0),
    )
    budget = RecordedBudget(
        result="linearity_x",
        rows=tuple(
            RecordedBudgetRow(
                quantity=name,
                estimate=estimate,
                unit=unit,
                standard_uncertainty=u,
                distribution=distribution,  # type: ignore[arg-type]
                sensitivity=c,
                degrees_of_freedom=nu,
            )
            for name, estimate, unit, u, distribution, c, nu in rows
        ),
        note="the line depends on the readings",
    )
    return CalibrationRecord(
        serial="11002",
        product="rate_gyro_triad",
        sensor="gyro",
        method="rate_gyro",
        model=Model(name="line", equation="Y = Y_0 + K R"),
        quantities=(
            quantity("sensitivity_x", "K", 0.050698, sensitivity_unit, 4.2e-6),
            quantity("intercept_x", "Y_0", -0.001116, "V", 2.7e-4),
            quantity("linearity_x", "l", 7.8e-4, "1", budget.standard_uncertainty),
            quantity("hysteresis_x", "h", 8.3e-4, "V", 1.9e-4),
        ),
        tables=(
            RecordTable(
                name="readings_x",
                columns=(
                    _column("rate", "deg/s", RATES_DEG_S),
                    *(_column(name, "V", values) for name, values in strokes.items()),
                    _column("mean", "V", means),
                    _column("residual", "V", residual),
                ),
                note="three strokes up and three down; the table is locked at 0",
            ),
        ),
        budgets=(budget,),
        recordings=_recordings("11002-eleven-points-x"),
        stand=StandReference(id="rt-1", kind="single_axis_rate_table", calibration_due=date(2026, 12, 31)),
        environment=Environment(stand_temperature=ROOM),
        valid_temperature=ROOM,
        code=CODE,
        measured_at=MEASURED,
        created_at=CREATED,
    )


def fog() -> CalibrationRecord:
    """Pure lag of a fibre-optic gyro: bounds, no deviation."""
    gaps = 2.4223e-4 + np.random.default_rng(5).uniform(0.0, 4.94e-4, 64)
    return CalibrationRecord(
        serial="FOG-3-0001",
        product="fog",
        sensor="gyro",
        method="pure_lag",
        model=Model(name="pure_lag", equation="y(t) = u(t − τ)"),
        quantities=(
            CalibratedQuantity(
                name="pure_lag",
                symbol="τ",
                value=2.4223e-4,
                unit="s",
                interval=Interval(lower=2.3927e-4, upper=2.4519e-4, probability=0.99),
            ),
            CalibratedQuantity(
                name="frame_period", symbol="T_f", value=5.0e-4, unit="s", standard_uncertainty=1.2e-9
            ),
        ),
        tables=(
            RecordTable(
                name="shots",
                columns=(
                    _column("shot", "1", np.arange(1, 65)),
                    _column("delay", "s", np.round(gaps, 9)),
                ),
            ),
        ),
        recordings=_recordings(*(f"fog-3-0001-pure-lag-{k}" for k in range(1, 4))),
        stand=StandReference(
            id="ir-1", kind="impact_rig", calibration_due=date(2026, 2, 1), calibration_overdue=True
        ),
        environment=Environment(unit_temperature=ROOM),
        code=CODE,
        measured_at=MEASURED,
        created_at=CREATED,
    )


def pulse_imu() -> CalibrationRecord:
    """Kax, K2x and D of paper 5, with their dependence."""
    names = ("scale_factor_asymmetry_x", "odd_quadratic_nonlinearity_x", "g_sensitivity_x", "g_sensitivity_y")
    symbols = ("K_ax", "K_2x", "D_1x", "D_2x")
    values = (1.62e-4, 1.27e-6, 2.31e-7, -1.08e-7)
    units = ("1", "1/(m/s^2)", "rad/s/(m/s^2)", "rad/s/(m/s^2)")
    u = np.array([2.1e-5, 1.4e-7, 1.9e-8, 2.0e-8])
    correlation = np.array([[1, -0.72, 0, 0], [-0.72, 1, 0, 0], [0, 0, 1, 0.11], [0, 0, 0.11, 1]])
    overload = np.arange(1.0, 13.0)
    return CalibrationRecord(
        serial="PI-2-0009",
        product="pulse_imu",
        sensor="acc",
        method="sinusoidal_overload",
        model=Model(name="sinusoidal_overload", equation="N± = K1 (V ± K_ax |V| / 2 + K_2x S)"),
        quantities=tuple(
            CalibratedQuantity(
                name=name,
                symbol=symbol,
                value=value,
                unit=unit,
                standard_uncertainty=float(one),
                degrees_of_freedom=40.0,
                coverage_factor=2.06,
            )
            for name, symbol, value, unit, one in zip(names, symbols, values, units, u, strict=True)
        ),
        covariance=(covariance_block(names, np.outer(u, u) * correlation),),
        tables=(
            RecordTable(
                name="overloads",
                columns=(
                    _column("overload", "g", overload),
                    _column("scale_factor_asymmetry", "1", 1.6e-4 / overload + 1.4e-5),
                    _column("odd_quadratic_nonlinearity", "1/(m/s^2)", 1.2e-6 + 2e-7 / overload),
                    _column("bias_part", "1", 1.02e-4 / overload),
                ),
                note="K1 off by 100 ppm biases K2 by 1.27e-5/g at 10 g, K0 off by 1 mg biases Kax by 1.6e-4",
            ),
        ),
        recordings=_recordings("pi-2-0009-overload"),
        stand=StandReference(id="so-1", kind="sinusoidal_overload_rig", calibration_due=date(2026, 6, 30)),
        environment=Environment(unit_temperature=ROOM, gravity_m_s2=9.7936),
        valid_temperature=ROOM,
        code=CODE,
        created_at=CREATED,
    )


def mems_ahrs() -> CalibrationRecord:
    """Biases over temperature of an attitude unit."""
    temperature = np.arange(-40.0, 71.0, 5.0)
    bias = {
        axis: 1e-3 * k * ((temperature - 25) / 60) ** 2
        for axis, k in zip("xyz", (1.9, -1.1, 0.7), strict=True)
    }
    return CalibrationRecord(
        serial="MA-5-0012",
        product="mems_ahrs",
        sensor="gyro",
        method="temperature",
        model=Model(name="temperature_nodes", equation="N − σ(N, T) = M E + D"),
        quantities=tuple(
            CalibratedQuantity(
                name=f"bias_{axis}",
                symbol=f"D_{axis}",
                value=value,
                unit="rad/s",
                standard_uncertainty=2.4e-5,
                degrees_of_freedom=118.0,
                coverage_factor=2.02,
            )
            for axis, value in zip("xyz", (1.21e-3, -3.4e-4, 5.6e-4), strict=True)
        ),
        tables=(
            RecordTable(
                name="temperature_nodes",
                columns=(
                    _column("temperature", "degC", temperature),
                    *(_column(f"bias_{axis}", "rad/s", values) for axis, values in bias.items()),
                    *(
                        _column(f"scale_factor_error_{axis}", "ppm", k * (temperature - 25))
                        for axis, k in zip("xyz", (11.2, -7.4, 9.6), strict=True)
                    ),
                ),
                note="differences from room temperature; straight between the nodes",
            ),
        ),
        recordings=_recordings(*(f"ma-5-0012-soak-{t:+.0f}" for t in temperature)),
        stand=StandReference(id="th-1", kind="thermal_turntable", calibration_due=date(2027, 1, 15)),
        environment=Environment(
            unit_temperature=TemperatureSpan(low_c=-39.6, high_c=71.2),
            stand_temperature=TemperatureSpan(low_c=-40.1, high_c=70.2),
        ),
        valid_temperature=TemperatureSpan(low_c=-40.0, high_c=70.0),
        code=CODE,
        measured_at=MEASURED,
        created_at=CREATED,
    )


SAMPLES = {made.__name__: made for made in (gnc_module, rate_gyro_triad, fog, pulse_imu, mems_ahrs)}

DETAILS = CertificateDetails(
    number="CAL-2026-0117",
    issued=date(2026, 3, 6),
    laboratory=Party(
        name="Inertial Calibration Laboratory", address="12 Meridian Road, Building C", reference="L 4711"
    ),
    customer=Party(name="Aerostar Flight Systems", address="3 Hangar Lane", reference="PO 88-1204"),
    unit_type="TSZ-12AA",
    manufacturer="Northfield Gyros",
    operator="J. Weaver",
    checked_by="Li Ming",
    approved_by="R. Thread",
    standards=(
        WorkingStandard(
            name="Digital multimeter",
            id="DMM-6",
            certificate="E-2025-3391",
            calibration_due=date(2026, 8, 14),
            accuracy="±(0.0035 % + 0.0005 %)",
        ),
    ),
    relative_humidity="45 % … 52 %",
    tolerances={"linearity_x": Tolerance(unit="%", upper=0.2, source="TSZ-12AA data sheet")},
    remarks=("The unit was warmed up for 30 minutes before the first stroke.",),
)
CHINESE_DETAILS = DETAILS.model_copy(
    update={
        "laboratory": Party(name="惯性计量校准实验室", address="子午路 12 号 C 座", reference="L 4711"),
        "customer": Party(name="航星飞行系统有限公司", address="机库巷 3 号", reference="88-1204"),
        "operator": "李明",
        "checked_by": "曾建华",
        "approved_by": "钟德辉",
        "remarks": ("首个行程前，被校产品已预热 30 min。",),
    }
)
