"""Twin against recording: where the gap lies, which effect causes it, how far adding it closes it.

Pure but for its report and command line. May import `dut_emulator`, `calibration` and `protocol`.
"""
