"""Web pages over a read model of the line. Reads; never decides.

`view_models.py` is pure. May import `protocol`.
"""
