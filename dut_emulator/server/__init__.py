"""The bench server: emulated units, stands and instruments over real links, on the bench's own clock.

`bench_clock`, `bench_model`, `slcan`, `link_faults`, `turntable_commands` are pure; `links`,
`control_channel`, `line_server`, `unit_store` and `bench_server` are the shell (one asyncio process).
"""
