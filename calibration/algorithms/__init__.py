"""Pure methods: arrays in, coefficients with covariance out.

No clock, no files, no randomness. Every method states its model, its equation and its units.
"""
