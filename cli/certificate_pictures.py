"""Pictures of a certificate for the documentation: `python -m cli.certificate_pictures docs/images`.

An emulated rate gyro triad is recorded, calibrated and certified, as its mark on the page says.
"""

import io
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

PAGES = 2
RESOLUTION_PPI = 90.0
COLOURS = 160
LANGUAGES = ("en", "zh")
DETAILS = """
laboratory: {name: Inertial Calibration Laboratory, address: 12 Meridian Road}
customer: {name: Aerostar Flight Systems, reference: PO 88-1204}
tolerances: {scale_factor_nonlinearity: {unit: "%", upper: 0.2, source: data sheet}}
"""


def write_pictures(folder: Path) -> tuple[Path, ...]:
    """certificate-en.png and certificate-zh.png: the first pages side by side."""
    from calibration.certificate.composing import certificate
    from calibration.certificate.details import parse_details
    from calibration.certificate.printing import pages_as_png
    from cli.calibration_record_files import read_record

    details = parse_details(DETAILS, "details of the pictures")
    with TemporaryDirectory() as work:
        record = read_record(_calibrated(Path(work)))
    written: list[Path] = []
    for language in LANGUAGES:
        document = certificate(record, details, language)
        pages = pages_as_png(document, record.canonical_json(), RESOLUTION_PPI)[:PAGES]
        path = folder / f"certificate-{language}.png"
        path.write_bytes(_side_by_side(pages))
        written.append(path)
    return tuple(written)


def _calibrated(work: Path) -> Path:
    """The record of the first axis."""
    from cli.main import main

    product = "rate_gyro_triad"
    arguments = [product, "eleven_point", "--out", str(work / "recordings"), "--form", "folder"]
    if main(["emulator", "record", *arguments, "--serial", "RG-0007"]) or main(
        ["calibrate", str(work / "recordings"), "--record", str(work / "records")]
    ):
        raise SystemExit(1)
    return sorted((work / "records").glob("*gyro_x*.json"))[0]


def _side_by_side(pages: list[bytes]) -> bytes:
    from PIL import Image

    images = [Image.open(io.BytesIO(page)).convert("RGB") for page in pages]
    whole = Image.new("RGB", (sum(one.width for one in images), images[0].height), "white")
    left = 0
    for one in images:
        whole.paste(one, (left, 0))
        left += one.width
    drawn = io.BytesIO()
    whole.quantize(COLOURS).save(drawn, "png", optimize=True)
    return drawn.getvalue()


if __name__ == "__main__":
    for path in write_pictures(Path(sys.argv[1])):
        sys.stdout.write(f"{path}: {path.stat().st_size} bytes\n")
