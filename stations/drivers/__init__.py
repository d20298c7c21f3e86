"""Drivers: clocks, links, instruments and stands of one bench, behind `protocol/instruments.py`.

A driver is a cheap view of a shared session with one branch's clock; sessions stay open between
sequences. The same classes serve an emulated bench and hardware: only resource strings differ.
"""
