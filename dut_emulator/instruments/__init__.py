"""SCPI instruments as pure state machines: a line and the bench's time come in, an answer goes out.

Power supply, multimeter, oscilloscope and socket board. They see the units through the `Protocol`s in
`wiring.py` and know nothing of sockets or clocks. May import `protocol` and `dut_emulator.interfaces`.
"""
