"""Certificates and original records of calibrations: record → document → pages.

Pure but for `printing`, which reads the machine's fonts: a document follows from the record, the details
that a laboratory adds, and the language; no date comes from the clock. Equal input, equal bytes.
"""
