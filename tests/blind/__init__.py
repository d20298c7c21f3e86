"""The blind check of the gap diagnosis: own physics, sealed labels, an oracle and a scorer.

Nothing here may import `gap_diagnosis` or `dut_emulator`, except the step that calls the engine
(`engine_calls.py`), in a process of its own. See README.md.
"""
