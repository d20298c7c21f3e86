"""The command line: composes the shells below, and nothing else."""
