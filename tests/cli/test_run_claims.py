"""Runs on one machine stay apart, even when they begin at once."""

import json
import os
import socket
from pathlib import Path

import pytest

from cli.main import main
from cli.run_claims import claimed_folder, claimed_port, demanded_port
from protocol.errors import TestloomError


def test_two_runs_that_begin_at_once_do_not_share_a_port(free_port: int) -> None:
    """Nobody listens yet when the second run looks: the first one's router is still being started."""
    with claimed_port(free_port) as first, claimed_port(free_port) as second:
        assert first == free_port
        assert second != free_port
    with claimed_port(free_port) as again:
        assert again == free_port


def test_a_port_that_a_stranger_has_is_left_to_him(free_port: int) -> None:
    with socket.socket() as stranger:
        stranger.bind(("127.0.0.1", free_port))
        stranger.listen()
        with claimed_port(free_port) as port:
            assert port != free_port
        with pytest.raises(TestloomError, match="is in use"):
            demanded_port(free_port, "--dashboard-port")


def test_runs_of_one_second_get_folders_of_their_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    folders = {claimed_folder(None) for _ in range(3)}
    assert len(folders) == 3
    assert all(json.loads((folder / "processes.json").read_text()) == [] for folder in folders)


def test_a_folder_is_claimed_once(tmp_path: Path) -> None:
    claimed_folder(tmp_path / "run")
    with pytest.raises(TestloomError, match="holds a run already"):
        claimed_folder(tmp_path / "run")
    (tmp_path / "file").touch()
    with pytest.raises(TestloomError, match="cannot be made"):
        claimed_folder(tmp_path / "file")


def test_a_summary_without_a_place_is_refused_before_the_line_starts(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run, summary = tmp_path / "run", tmp_path / "nowhere" / "s.json"
    assert main(["up", "--dir", str(run), "--summary", str(summary)]) == 1
    assert "cannot be written" in capsys.readouterr().err
    assert not run.exists()


def test_a_page_on_a_port_in_use_is_refused_before_the_line_starts(
    tmp_path: Path, free_port: int, capsys: pytest.CaptureFixture[str]
) -> None:
    with socket.socket() as stranger:
        stranger.bind(("127.0.0.1", free_port))
        stranger.listen()
        assert main(["up", "--dir", str(tmp_path / "run"), "--dashboard-port", str(free_port)]) == 1
    assert f"The port {free_port} is in use." in capsys.readouterr().err
    assert os.listdir(tmp_path / "run" / "logs") == []
