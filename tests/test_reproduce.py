"""The evidence command end to end, on scenes that are far too short to show anything."""

import json
from pathlib import Path

import pytest

pytest.importorskip("open3d", reason="the scenes are rendered by Open3D: pip install '.[sim]'")


def test_the_report_is_made_of_every_job_that_needs_no_recording(tmp_path, monkeypatch, capsys):
    beside = tmp_path / "beside"  # the repository's root on the path would shadow the installed package
    beside.mkdir()
    (beside / "benchmarks").symlink_to(Path(__file__).resolve().parents[1] / "benchmarks")
    monkeypatch.syspath_prepend(beside)
    from benchmarks import reproduce

    arguments = [str(tmp_path), "--frames", "5", "--seeds", "21", "--jobs", "clean,noisy"]
    monkeypatch.setattr("sys.argv", ["reproduce", *arguments])
    reproduce.main()
    assert "What must show" in capsys.readouterr().out
    told = json.loads((tmp_path / "report.json").read_text("utf-8"))
    promised = {row[0]: row for row in told["tables"][0]["rows"]}
    assert len(promised) == 8 and all(row[3] in ("yes", "NO") for row in promised.values())
    assert [len(told["evaluations"][job][0]["logs"]) for job in ("clean", "noisy")] == [3, 3]
    html = (tmp_path / "report.html").read_text("utf-8")
    assert all(row["title"].split(":")[0] in html for row in told["tables"])
