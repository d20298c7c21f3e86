"""What a station knows of an IMU on a three-axis turntable: poses, truth, captures, their recording.

`truth.py` and `alignment.py` are pure functions over arrays; `capture.py` moves the stand and the unit
through a step's context. What the coefficients are is for `calibration` to say.
"""
