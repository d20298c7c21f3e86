"""Evaluations of recordings by the papers' methods: one module a profile, routed by `by_profile`.

Pure: from recordings to figures in the form that records have (`method_evaluation`).
"""
