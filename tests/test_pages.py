"""What comes from logs is text on pages and in recordings' documents, whatever it would like to be."""

import numpy as np
import pytest
from inert import HOSTILE, read_markdown, read_page
from own_log import OwnLog, own_frames, room_depth
from small_room import write_masks

import vlmm_log
from vlmm_log.evaluation.page import Table, page
from vlmm_log.pages.charts import figure, plain, svg
from vlmm_log.settings import Settings


class HostileLog(OwnLog):
    name, notes = f"log {HOSTILE}", (f"topic {HOSTILE}\n\n# a\n[r]: http://e.example", "![a][r]")


@pytest.fixture(scope="module")
def compared(tmp_path_factory):
    """Two runs of a log that is hostile in name, notes, labels, queries and settings, and their difference."""
    folder = tmp_path_factory.mktemp("hostile")
    write_masks(folder / "masks", {k: np.where(room_depth() < 2, 1, 2) for k in range(3)})
    asked = ["query.parser=paper", "keyframes.gap=1", f"objects.segmenter=masks:{folder / 'masks'}"]
    for name, extra in (("a", "noise.scale=1"), ("b", f"read.topics={HOSTILE}")):
        (folder / "masks/labels.txt").write_text(f"1 {name} {HOSTILE}\n2 wall\n")
        vlmm_log.process(
            HostileLog(own_frames()),
            settings=Settings.load(sets=[*asked, extra]),
            queries=[f"what is moving {name} {HOSTILE}"],
            rrd=folder / f"{name}.rrd",
            map=folder / f"{name}.json",
        )
    vlmm_log.diff(folder / "a.rrd", folder / "b.rrd", html=folder / "d.html", rrd=folder / "d.rrd")
    vlmm_log.diff(folder / "a.json", folder / "b.json", html=folder / "maps.html")
    return folder


@pytest.mark.parametrize("name", ["d.html", "maps.html"])
def test_a_difference_s_page_is_inert(compared, name):
    live, text = read_page((compared / name).read_text())
    assert live == []
    assert HOSTILE in text


def documents(rrd):
    """Texts of the Markdown documents in a recording."""
    from rerun.chunk import RrdReader

    for chunk in RrdReader(str(rrd)).store().stream():
        batch = chunk.to_record_batch()
        for column in batch.schema.names:
            if column.endswith("TextDocument:text"):
                yield from (row[0] for row in batch[column].to_pylist() if row)


@pytest.mark.parametrize("name", ["a.rrd", "b.rrd", "d.rrd"])
def test_documents_in_recordings_fetch_nothing(compared, name):
    (document,) = documents(compared / name)
    live, text = read_markdown(document)
    assert live == []
    assert HOSTILE in text


def test_an_evaluation_s_page_is_inert():
    html = page(f"title {HOSTILE}", [], [Table(HOSTILE, [HOSTILE], [[HOSTILE]], HOSTILE)])
    live, text = read_page(html)
    assert live == []
    assert text.count(HOSTILE) == 7  # the title and the table's stand twice


def test_charts_show_texts_as_they_are():
    drawn = figure(4, 2)
    drawn.subplots().set_title(plain(HOSTILE))
    live, text = read_page(svg(drawn))
    assert live == []
    assert HOSTILE in text
