"""Shared instruments of a bench: who may use them now, first come, first served."""

from protocol.bench_description import BenchDescription


class Arbitration:
    """The instruments that the sockets of one bench share: one object for all its SequenceRunners."""

    def __init__(self, bench: BenchDescription) -> None:
        self.bench = bench

    def close(self) -> None:
        """Close the sessions of the shared instruments."""
