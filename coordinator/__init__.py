"""The coordinator: moves every unit along its route, keeps every result, watches the yield.

`core/` is pure (events in, commands out); store and daemon are its shell. May import `protocol`.
"""
