# pyright: strict
"""What a certificate says of each method: what was done, after which source, and what we correct in it.

The sources are cited as in docs/papers.md.
"""

from dataclasses import dataclass

from calibration.certificate.document import Say


@dataclass(frozen=True)
class MethodWords:
    """Of one method. `corrections`: where the source's printed form is not the one that was computed."""

    title: str
    source: str
    corrections: tuple[str, ...] = ()


def method_words(method: str, model: str, say: Say) -> MethodWords:
    """The words of a method, or of a model of it that has its own.

    A method that is not known here is named, and nothing is claimed of it.
    """
    known = _OF_MODELS.get((method, model)) or _METHODS.get(method)
    if known is None:
        return MethodWords(say(method.replace("_", " ")), say("no description of this method is held here"))
    return known(say)


def method_name(method: str, model: str, say: Say) -> str:
    """A few words, for a heading."""
    names = {
        "imu_calibration": say("scale factors, axes and bias on a stand"),
        "ferraris": say("scale factors, axes and bias by hand"),
        "multi_position": say("scale factors, axes and bias in gravity"),
        "rate_gyro": say("line over eleven rates"),
        "pure_lag": say("pure lag"),
        "sinusoidal_overload": say("sinusoidal overload"),
        "temperature_compensation": say("temperature compensation"),
        "temperature_ramp": say("bias over temperature ramps"),
        "thermal_network": say("thermal network"),
        "magnetometer": say("hard and soft iron"),
        "allan_variance": say("noise by Allan variance"),
        "bias": say("bias at rest"),
        "repeatability": say("repeatability"),
        "rate_staircase": say("staircase of rates"),
        "frequency_response": say("frequency response"),
        "tumble": say("tumble in gravity"),
        "swing": say("swing"),
        "attitude_error": say("attitude error"),
    }
    spun = say("spin in one magnetic field") if (method, model) == ("magnetometer", "spin") else ""
    return spun or names.get(method) or say(method.replace("_", " "))


def _imu_calibration(say: Say) -> MethodWords:
    return MethodWords(
        say("known attitudes and turns of known angle on a stand, least squares with stated uncertainties"),
        say("Cheng, Chai & Guo: test system for the GNC module, 2022, eqs. (1)–(4)"),
        (
            say("eq. (3) gives the matrix from rates to outputs, and transposed: its inverse is used."),
            say("eq. (4) divides by an angle: the bias is the cross-axis integrals' sum over four times T."),
            say("eq. (2) has no place for the bias: a column of ones is added."),
        ),
    )


def _ferraris(say: Say) -> MethodWords:
    return MethodWords(
        say("six poses on the faces of the housing and a turn about each axis (Ferraris)"),
        say("Ferraris, Grimaldi & Parvis, Sensors and Materials 7 (1995) 311"),
    )


def _multi_position(say: Say) -> MethodWords:
    return MethodWords(
        say("many attitudes at rest, unknown: only the magnitude of gravity is used"),
        say("Tedaldi, Pretto & Menegatti, ICRA 2014, eq. (10)"),
    )


def _rate_gyro(say: Say) -> MethodWords:
    return MethodWords(
        say("11 equally spaced rates, up and down, on a rate table; straight line through the means"),
        say("Zhong, Zeng & Li: calibration of a three-axis rate gyro, eqs. (1)–(10); GJB 1692-93"),
        (
            say("the table's accuracy of 1e-4 is relative: u(R) is taken so, not as an absolute rate."),
            say(
                "line and readings depend on each other: residuals carry the factor √(1 − h), h the leverage."
            ),
            say("least squares does not have the smallest non-linearity: the minimax line has."),
        ),
    )


def _pure_lag(say: Say) -> MethodWords:
    return MethodWords(
        say("impacts on a rig, the unit's frames stamped against the trigger: bounds of the pure lag"),
        say("Chen, Yang, Zhou & Shu: FOG pure lag test system, J. Zhejiang Univ. (Eng.) 52 (2018) 781"),
        (
            say("eq. (22) takes the pairs of shots as independent: the exact probability is used."),
            say("the bounds are min(Δt) and max(Δt) − frame period over all shots: valid for every lag."),
        ),
    )


def _sinusoidal_overload(say: Say) -> MethodWords:
    return MethodWords(
        say("sinusoidal linear overload: pulses of the two half-cycles against the measured motion"),
        say("Lin, Zhou & Wang: calibration of dynamic errors of an IMU by sinusoidal overload"),
        (
            say("the measured half-cycles are used: a slider-crank's motion is no sinusoid."),
            say("the two equations of the half-cycles are solved exactly; K0 and K1 enter the uncertainty."),
        ),
    )


def _temperature(say: Say) -> MethodWords:
    return MethodWords(
        say("calibration at temperatures across the range, coefficients interpolated between the nodes"),
        say("Liu, Hang, Li & Sun: MEMS inertial attitude reference system, 2012, eqs. (2)–(3)"),
        (
            say("coefficients are fitted on the output and interpolated, not those of the nearest node."),
            say("beyond the calibrated range nothing is stated."),
        ),
    )


def _thermal_network(say: Say) -> MethodWords:
    return MethodWords(
        say("switched on in steady air: heat capacities and conductances fitted to the nodes' temperatures"),
        say("Liu, Hang, Li & Sun: MEMS inertial attitude reference system, 2012, section 2.1"),
        (say("the paper's simulated and measured rises are two sets of figures, and are told apart."),),
    )


def _temperature_ramp(say: Say) -> MethodWords:
    return MethodWords(
        say("at rest while the temperature ramps down and up: bias, hysteresis, what follows dT/dt"),
        say("IEEE Std 952-1997, 12.12; IEEE Std 528-2019 (hysteresis)"),
        (say("bias per rate of temperature and hysteresis are told apart where the soaks begin."),),
    )


def _magnetometer(say: Say) -> MethodWords:
    return MethodWords(
        say("turned all ways in one magnetic field: hard and soft iron from the ellipsoid of the readings"),
        "",
    )


def _spin(say: Say) -> MethodWords:
    return MethodWords(
        say("spun in one magnetic field: zeros, sensitivity ratio and orthogonality of two channels"),
        say("Cheng, Chai & Guo: test system for the GNC module, 2022, eqs. (5)–(9)"),
        (say("eq. (9) lacks the division by cos α; α is fitted to an ellipse, not read off one sample."),),
    )


def _allan(say: Say) -> MethodWords:
    return MethodWords(
        say("Allan variance of a record at rest: coefficients of the noise terms"),
        say("IEEE Std 952-1997, annex C"),
    )


def _bias(say: Say) -> MethodWords:
    return MethodWords(
        say("output at rest less the Earth rate; standard deviation of averages of 10 s over one hour"),
        say("GJB 2426A; IEEE Std 952-1997; Cheng, Chai & Guo: GNC module, 2022, section 5.1"),
    )


def _repeatability(say: Say) -> MethodWords:
    return MethodWords(
        say("standard deviation of a figure over runs, each with its own uncertainty"),
        say("GJB 2426A; IEEE Std 952-1997; Cheng, Chai & Guo: GNC module, 2022, section 5.1"),
    )


def _rate_staircase(say: Say) -> MethodWords:
    return MethodWords(
        say("staircase of rates about each axis, up and down; line by least squares"),
        say("IEEE Std 952-1997; GJB 2426A; IEEE Std 528-2001"),
    )


def _frequency_response(say: Say) -> MethodWords:
    return MethodWords(
        say("sine of rising frequency; transfer function by bands, then gain, delay and first-order lag"),
        say("IEEE Std 528-2001: frequency response"),
    )


def _tumble(say: Say) -> MethodWords:
    return MethodWords(
        say("slow tumble about horizontal axes; the Earth rate taken out attitude by attitude"),
        say("IEEE Std 952-1997; IEEE Std 1293-1998"),
        (say("only differences of quadratic terms show in gravity: that of each own axis is taken."),),
    )


def _swing(say: Say) -> MethodWords:
    return MethodWords(
        say(
            "swing on a turntable: lag of the angle in quadrature with it, cycle by cycle; the attitude's "
            "error without it"
        ),
        say("Liu, Hang, Li & Sun: MEMS inertial attitude reference system, 2012, section 4.1"),
        (
            say(
                "the source lays 2.6° to unsynchronised clocks: only a common trigger separates that from a "
                "lag."
            ),
        ),
    )


def _attitude_error(say: Say) -> MethodWords:
    return MethodWords(
        say("flight or drive against a reference: root mean square of roll and pitch errors, phase by phase"),
        say("Liu, Hang, Li & Sun: MEMS inertial attitude reference system, 2012, sections 3 and 4.2"),
        (say("errors have a memory: intervals count independent samples, not all of them."),),
    )


def _strapdown_error(say: Say) -> MethodWords:
    return MethodWords(
        say("flight or drive against a reference: root mean square of roll and pitch errors, phase by phase"),
        say("Liu, Hang, Li & Sun: MEMS inertial attitude reference system, 2012, sections 3 and 4.2"),
        (
            say(
                "gates are set on the norm and on V ω, with their noise; the printed norm gate admits 26° of "
                "tilt."
            ),
            say("errors have a memory: intervals count independent samples, not all of them."),
        ),
    )


_OF_MODELS = {
    ("magnetometer", "spin"): _spin,
    ("attitude_error", "strapdown_attitude_error"): _strapdown_error,
}
_METHODS = {
    "imu_calibration": _imu_calibration,
    "ferraris": _ferraris,
    "multi_position": _multi_position,
    "rate_gyro": _rate_gyro,
    "pure_lag": _pure_lag,
    "sinusoidal_overload": _sinusoidal_overload,
    "temperature": _temperature,
    "temperature_compensation": _temperature,
    "temperature_ramp": _temperature_ramp,
    "thermal_network": _thermal_network,
    "magnetometer": _magnetometer,
    "allan": _allan,
    "allan_variance": _allan,
    "bias": _bias,
    "repeatability": _repeatability,
    "rate_staircase": _rate_staircase,
    "frequency_response": _frequency_response,
    "tumble": _tumble,
    "swing": _swing,
    "attitude_error": _attitude_error,
}
