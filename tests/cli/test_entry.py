"""Ctrl-C while the command line is still being loaded."""

import sys

import pytest

from cli import entry


class _InterruptedWhileLoading:
    def find_spec(self, name: str, *_: object) -> None:
        if name == "cli.main":
            raise KeyboardInterrupt


def test_an_interrupt_while_loading_ends_without_a_traceback(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delitem(sys.modules, "cli.main", raising=False)
    monkeypatch.setattr(sys, "meta_path", [_InterruptedWhileLoading(), *sys.meta_path])
    with pytest.raises(SystemExit) as leaving:
        entry.run()
    assert leaving.value.code == 130
