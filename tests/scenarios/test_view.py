"""`appli view`, `appli run --view`, and pictures of recordings."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from PIL import Image

from scenarios import screenshots, view
from scenarios.cli import main
from tests.test_recording import rerun
from tests.ticks import WORLD, drive
from twin.recording import Recorder
from twin.recording.viewer import has_display


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("view") / "run.rrd"
    with Recorder(path, WORLD, {"method": "dwa", "seed": 0}) as recorder:
        for tick in drive(60):
            recorder.add(tick)
    return path


def refusal(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> str:
    """What a wrong command says: one line, exit code 2, nothing on stdout."""
    with pytest.raises(SystemExit) as stop:
        main(arguments)
    said = capsys.readouterr()
    assert stop.value.code == 2
    assert said.out == ""
    assert len(said.err.splitlines()) == 1
    return said.err.removeprefix("appli: ")


def test_a_missing_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    said = refusal(["view", str(tmp_path / "x.rrd")], capsys)
    assert said.startswith(f"cannot read the recording {tmp_path / 'x.rrd'}: no such file; record one with: appli run")


@pytest.mark.parametrize("content", [b"", b"hello " * 100])
def test_another_file(content: bytes, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "x.rrd"
    path.write_bytes(content)
    assert refusal(["view", str(path)], capsys).startswith(f"cannot read the recording {path}: ")


@pytest.mark.parametrize("share", [0.001, 0.3, 0.9])
def test_a_truncated_file(share: float, recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path, whole = tmp_path / "cut.rrd", recording.read_bytes()
    path.write_bytes(whole[: int(share * len(whole))])
    assert refusal(["view", "--web", str(path)], capsys).startswith(f"cannot read the recording {path}: ")
    assert refusal(["view", "--compare", str(recording), str(path)], capsys).startswith("cannot read")


def test_a_recording_of_something_else(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    import rerun as rr

    stream = rr.RecordingStream("another")
    stream.save(tmp_path / "x.rrd")
    stream.log("a", rr.TextLog("b"))
    stream.disconnect()
    assert "is not a recording of appli" in refusal(["view", str(tmp_path / "x.rrd")], capsys)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ([], "view shows one recording, not 0; try: appli view run.rrd"),
        (["a.rrd", "b.rrd"], "view shows one recording, not 2; try: appli view --compare a.rrd b.rrd"),
        (["--compare", "a.rrd"], "view shows two recordings, not 1; try: appli view --compare a.rrd b.rrd"),
        (["--port", "8080", "a.rrd"], "--port goes with --web"),
        (["--web", "--port", "70000", "a.rrd"], "--port must be 0 to 65535, not 70000"),
    ],
)
def test_a_wrong_command(arguments: list[str], said: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert refusal(["view", *arguments], capsys) == said + "\n"


def test_no_display_points_to_the_page(
    recording: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("twin.recording.viewer.has_display", lambda: False)
    for arguments in (["view", str(recording)], ["run", "open", "--view"]):
        assert refusal(arguments, capsys) == "no display to open a window on; try it with --web\n"


def test_web_without_view_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert refusal(["run", "open", "--web"], capsys) == "--web goes with --view\n"


def test_a_page_of_two_recordings_until_ctrl_c(
    recording: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    shown: list[Path] = []

    def wait(viewer: view.Viewer) -> None:
        raise KeyboardInterrupt

    def opened(files: list[Path], *rest: object) -> view.Viewer:
        shown.extend(files)
        assert files[0].is_file()
        return real(files, *rest)  # type: ignore[arg-type]

    real = view.Viewer
    monkeypatch.setattr(view.Viewer, "wait", wait)
    monkeypatch.setattr(view, "Viewer", opened)
    with pytest.raises(SystemExit) as stop:
        main(["view", "--web", "--compare", str(recording), str(recording)])
    assert stop.value.code == 0
    assert "open http://127.0.0.1:" in capsys.readouterr().err
    assert not shown[0].exists(), "the comparison is gone with its page"


def test_a_run_is_the_same_whether_it_is_watched_or_not(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    stayed: list[str | None] = []
    monkeypatch.setattr(view, "stay", lambda viewer: stayed.append(viewer.page))
    digests = []
    for name, options in (("alone", []), ("watched", ["--view", "--web"])):
        with pytest.raises(SystemExit) as stop:
            main(["run", "open", "--json", "--record", str(tmp_path / "made" / f"{name}.rrd"), *options])
        assert stop.value.code == 0
        said = capsys.readouterr()
        digests.append(json.loads(said.out)["digest"])
        assert ("open http://127.0.0.1:" in said.err) == bool(options)
    assert digests[0] == digests[1]
    assert len(stayed) == 1
    assert rerun("compare", tmp_path / "made" / "alone.rrd", tmp_path / "made" / "watched.rrd") == 0


# --- pictures


def test_a_picture_without_a_screen_says_what_is_missing(
    recording: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(screenshots, "has_display", lambda: False)
    monkeypatch.setattr("shutil.which", lambda _: None)
    reason = screenshots.screenshot(recording, tmp_path / "x.png")
    assert reason is not None
    assert "xvfb" in reason
    assert not (tmp_path / "x.png").exists()


@pytest.mark.slow
def test_a_picture_shows_the_recording(recording: Path, tmp_path: Path) -> None:
    reason = screenshots.screenshot(recording, tmp_path / "x.png", (1000, 600))
    if reason is not None and not has_display():
        pytest.skip(reason)
    assert reason is None
    with Image.open(tmp_path / "x.png") as image:
        assert image.size == (1000, 600)
        assert len(image.convert("RGB").getcolors(100_000) or []) > 100  # type: ignore[arg-type]
    assert (tmp_path / "x.png").stat().st_size < 300_000
