"""The effect catalogue: what lies between a stimulus and the numbers a sensor sends.

Pure: arrays, an explicit generator and an explicit state in, arrays out. May import `protocol` only.
"""
