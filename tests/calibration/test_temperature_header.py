"""The C header says what the model says: compiled and called, where there is a compiler."""

import ctypes
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from calibration.algorithms.coefficients import TriadCoefficients
from calibration.algorithms.temperature_compensation import TemperatureModel
from calibration.temperature_header import firmware_header
from protocol.errors import CalibrationError

M = np.array([[1.002, 0.003, -0.001], [-0.002, 0.998, 0.004], [0.0015, -0.0025, 1.001]])
COMPILER = shutil.which("cc")


def model(nodes: int = 23) -> TemperatureModel:
    generator = np.random.default_rng(1)
    coefficients = generator.normal(0.0, [1e-4, 5e-3, 0.1], (nodes, 3, 3))
    return TemperatureModel(
        room=TriadCoefficients("acceleration", M, np.array([0.2, -0.1, 0.3]), np.zeros((12, 12)), 0.0, 0),
        node_c=-40.0 + 5.0 * np.arange(nodes),
        coefficients=coefficients,
        covariance=np.zeros((3, 3 * nodes, 3 * nodes)),
        residual_rms_si=np.zeros(3),
        degrees_of_freedom=10,
        left_out=0,
    )


def test_the_text_is_the_same_for_the_same_model_and_refuses_bad_names() -> None:
    text = firmware_header(model(), "acc", "Unit A-17, record 3.")
    assert text == firmware_header(model(), "acc", "Unit A-17, record 3.")
    assert "Calibrated from -40 to 70 deg C" in text
    assert text.count("deg C */") == 23
    for name, origin in (("Acc", "x"), ("acc;", "x"), ("acc", "ends */ here"), ("acc", "two\nlines")):
        with pytest.raises(CalibrationError, match="no C name"):
            firmware_header(model(), name, origin)
    with pytest.raises(CalibrationError, match="two nodes"):
        firmware_header(model(1), "acc", "x")


@pytest.mark.skipif(COMPILER is None, reason="no C compiler")
def test_the_compiled_header_compensates_as_the_model_does(tmp_path: Path) -> None:
    (tmp_path / "acc.h").write_text(firmware_header(model(), "acc", "Unit A-17."), encoding="ascii")
    source = (
        '#include "acc.h"\nint call(const float *n, float t, float *e) { return acc_compensate(n, t, e); }\n'
    )
    (tmp_path / "acc.c").write_text(source, encoding="ascii")
    library = tmp_path / "acc.so"
    flags = ["-std=c99", "-Wall", "-Wextra", "-Werror", "-O1", "-shared", "-fPIC"]
    subprocess.run(
        [str(COMPILER), *flags, "-o", str(library), str(tmp_path / "acc.c")], check=True, timeout=60
    )
    call = ctypes.CDLL(str(library)).call
    call.argtypes = [ctypes.POINTER(ctypes.c_float), ctypes.c_float, ctypes.POINTER(ctypes.c_float)]
    generator = np.random.default_rng(2)
    temperature = np.concatenate([generator.uniform(-60.0, 95.0, 200), [-40.0, 70.0, -41.5, 71.5, 25.0]])
    output = generator.uniform(-12.0, 12.0, (len(temperature), 3))
    expected = model().compensate(output, temperature)
    for row, degrees in enumerate(temperature):
        n, e = (ctypes.c_float * 3)(*output[row]), (ctypes.c_float * 3)()
        within = call(n, degrees, e)
        np.testing.assert_allclose(list(e), expected.input_si[row], atol=2e-5)
        assert bool(within) is not bool(expected.beyond_calibrated_range[row])
