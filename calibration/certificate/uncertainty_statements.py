# pyright: strict
"""Where the uncertainties of a method come from, in a sentence: printed where no budget is held."""

from calibration.certificate.document import Say


def uncertainty_statement(method: str, model: str, say: Say) -> str:
    """One sentence; of a method that is not known here, that nothing more is held."""
    known = _on_stands(say) | _of_records_alone(say)
    return (
        known.get(f"{method}/{model}")
        or known.get(method)
        or say("The standard uncertainties are those of the record; no budget of them is held here.")
    )


def _on_stands(say: Say) -> dict[str, str]:
    of_line = say(
        "Standard uncertainties by generalised least squares: white and slow noise of the output, the "
        "stand's rate and angles, the unit's axes against the stand; what is stated is among the assumptions."
    )
    of_triad = say(
        "Standard uncertainties by least squares over all poses and turns: scatter and slow noise of the "
        "output, the stand's angles, the unit's clock; stated figures are among the assumptions."
    )
    return {
        "imu_calibration": of_triad,
        "ferraris": of_triad,
        "multi_position": say(
            "Standard uncertainties from the scatter of the magnitudes about gravity, by least squares."
        ),
        "rate_staircase": of_line,
        "tumble": of_line,
        "pure_lag": say(
            "The lag lies between its bounds for certain: rectangular distribution, u is half their distance "
            "over √3. Rounding of the stamps and the response's rise are within the bounds."
        ),
        "sinusoidal_overload": say(
            "Standard uncertainties from the scatter of the cycles, the scale factors and the slow noise of "
            "the output; stated figures are among the assumptions."
        ),
        "temperature_compensation": say(
            "Standard uncertainties by least squares over all nodes at once: scatter and slow noise of the "
            "output; those of the matrix are of the calibration at room temperature."
        ),
        "temperature_ramp": say(
            "Standard uncertainties by generalised least squares: white and slow noise of the output, whose "
            "wander within a ramp looks like hysteresis."
        ),
        "thermal_network": say(
            "Standard uncertainties by least squares: scatter of the thermocouples, weighed with its memory, "
            "and the stated power."
        ),
    }


def _of_records_alone(say: Say) -> dict[str, str]:
    of_attitude = say(
        "Intervals from the chi-square distribution of the mean square; its degrees of freedom count the "
        "errors' independent samples. The reference and the mounting are part of the error."
    )
    return {
        "magnetometer": say(
            "Standard uncertainties from the distances to the ellipsoid, widened where these are slow, "
            "propagated to all terms together."
        ),
        "magnetometer/spin": say(
            "Standard uncertainties from the scatter about the ellipse and the field of the stand's motors."
        ),
        "allan_variance": say(
            "Standard uncertainties by generalised least squares over the averaging times, with the "
            "covariance of neighbouring ones; a term that is not told has an interval from zero."
        ),
        "rate_gyro": say(
            "Standard uncertainties from the scatter of the readings over the strokes up and down."
        ),
        "bias": say("Standard uncertainties by generalised least squares: white and slow noise."),
        "repeatability": say(
            "Chi-square distribution of the variance over the runs, with each run's own uncertainty."
        ),
        "frequency_response": say(
            "Standard uncertainties from the noise in each band of frequencies and from the clocks of unit "
            "and stand; delay and lag are correlated, their sum is told."
        ),
        "swing": say(
            "Standard uncertainties from the scatter of the cycles, the clocks and the gyro's g-sensitivity."
        ),
        "attitude_error": of_attitude,
    }
