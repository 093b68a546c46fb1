"""The movability prior: the table and its sources, names near it, a language model and what is told where it fails."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fake_endpoint import Reply, fake_endpoint, says
from vlmm_log.elements import Movability
from vlmm_log.models import prior
from vlmm_log.models.endpoint import KEY, Endpoint, Patience
from vlmm_log.models.prior import LlmPrior, TablePrior, load_prior, normal, read_table
from vlmm_log.settings import MapSettings, ObjectSettings
from vlmm_log.types import InputError

SHARED = Path(__file__).resolve().parents[2] / "shared/weights"
COUNTS = Path(os.environ.get("VLMM_LOG_WEIGHTS", SHARED)) / "ai2thor_types_movability.json"
COCO = """person, bicycle, car, motorcycle, airplane, bus, train, truck, boat, traffic light, fire hydrant, stop sign,
parking meter, bench, bird, cat, dog, horse, sheep, cow, elephant, bear, zebra, giraffe, backpack, umbrella, handbag,
tie, suitcase, frisbee, skis, snowboard, sports ball, kite, baseball bat, baseball glove, skateboard, surfboard,
tennis racket, bottle, wine glass, cup, fork, knife, spoon, bowl, banana, apple, sandwich, orange, broccoli, carrot,
hot dog, pizza, donut, cake, chair, couch, potted plant, bed, dining table, toilet, tv, laptop, mouse, remote,
keyboard, cell phone, microwave, oven, toaster, sink, refrigerator, book, clock, vase, scissors, teddy bear,
hair drier, toothbrush"""
NAMES = [name.strip() for name in COCO.split(",")]
MOVABLE = MapSettings().rho_tau
SECRET = "sk-do-not-tell-1234"


class FakeEmbedder:
    """Texts as given vectors; what was embedded is counted."""

    def __init__(self, **vectors):
        self.vectors, self.asked = vectors, []

    def texts(self, texts):
        self.asked += texts
        return np.array([self.vectors[t.replace(" ", "_")] for t in texts], np.float32)


def unasked():
    return TablePrior(FakeEmbedder(), read_table())


# ---- the table


def test_the_table_is_sorted_without_doubles_and_in_range():
    rows = [line.split(",") for line in prior.TABLE.read_text("utf-8").splitlines()]
    assert rows[0] == ["name", "rho", "source"]
    names = [name for name, _, _ in rows[1:]]
    assert names == sorted(set(names))
    assert [normal(name) for name in names] == names
    assert {source for *_, source in rows[1:]} == {"AI2-THOR", "vlmm-log"}
    assert all(0 <= float(rho) <= 1 for _, rho, _ in rows[1:])


def test_every_coco_name_is_known():
    assert len(NAMES) == 80
    assert [n for n in NAMES if n not in read_table()] == []


@pytest.mark.parametrize(
    ("names", "is_movable"),
    [
        (
            "person, people, cat, dog, bus, bicycle, cup, mug, chair, keyboard, mouse, laptop, book, remote",
            True,
        ),
        ("wall, floor, ceiling, window, door, sink, toilet, tv, monitor, television, refrigerator, plane, desk", False),
    ],
)
def test_what_can_move(names, is_movable):
    known = read_table()
    for name in names.split(", "):
        assert (known[name].rho >= MOVABLE) is is_movable, name


@pytest.mark.skipif(not COUNTS.exists(), reason="ai2thor_types_movability.json is absent; VLMM_LOG_WEIGHTS can name it")
def test_ai2thor_rows_are_those_its_counts_give():
    counts = json.loads(COUNTS.read_text("utf-8"))
    shares = {normal(kind): max(c["pickupable"], c["moveable"]) for kind, c in counts.items()}
    rows = {name: m.rho for name, m in read_table().items() if m.source == "table: AI2-THOR"}
    assert set(shares) - set(rows) == {"television"}  # a row of ours wins: see the README beside the table
    assert rows == pytest.approx({name: shares[name] for name in rows}, abs=1e-3)


# ---- names


@pytest.mark.parametrize(
    ("label", "name"),
    [
        ("mug", "mug"),
        ("  Coffee   machine ", "coffee machine"),
        ("CoffeeMachine", "coffee machine"),
        ("TVStand", "tv stand"),
        ("tv_stand", "tv stand"),
        ("CD", "cd"),
        ("TVs", "tvs"),
        ("t-shirt", "t shirt"),
        ("CHAIR", "chair"),
        ("_", ""),
        ("\n", ""),
    ],
)
def test_normal_names(label, name):
    assert normal(label) == name


@given(st.text())
def test_a_normal_name_is_its_own(label):
    assert normal(normal(label)) == normal(label)


@pytest.mark.parametrize(
    ("label", "name"),
    [
        ("cups", "cup"),
        ("Boxes", "box"),
        ("Knives", "knife"),
        ("shelves", "shelf"),
        ("teddy_bears", "teddy bear"),
        ("puppies", None),
        ("boot", "boots"),
        ("bus", "bus"),
        ("buses", "bus"),
        ("glass", "glass"),
        ("WineBottles", "wine bottle"),
    ],
)
def test_singular_plural_and_spelling_need_no_embedder(label, name):
    if name is None:
        with pytest.raises(KeyError):  # the fake has no vector: it was asked
            unasked()(label)
    else:
        assert unasked()(label) == read_table()[name]


def test_a_thing_without_a_name_is_unknown():
    assert unasked()("") == unasked()("  ") == Movability(0.5, "unknown")


# ---- names near the table

TABLE = {"mug": Movability(1.0, "table: a"), "cup": Movability(0.8, "table: a"), "wall": Movability(0.0, "table: b")}
SPACE = {"mug": [1, 0, 0], "cup": [0.8, 0.6, 0], "wall": [-1, -0.5, 0.2], "beaker": [1, 0.2, 0], "song": [0, 0, -1]}


@pytest.mark.parametrize("offset", [[0, 0, 0], [5, 5, 5]])
def test_similar_names_speak_for_one_another(offset):
    embed = FakeEmbedder(**{k: np.add(v, offset) for k, v in SPACE.items()})
    judged = TablePrior(embed, TABLE)("Beaker")
    assert judged.source.startswith("similar to mug 0.9")
    assert ", cup 0." in judged.source
    assert "wall" not in judged.source
    assert 0.9 < judged.rho < 1
    assert TablePrior(embed, TABLE)("song") == Movability(0.5, "unknown")


def test_the_nearer_name_weighs_more():
    embed = FakeEmbedder(a=[1, 0], b=[0, 1], c=[-1, -1], near_a=[2, 1])
    table = {"a": Movability(1, ""), "b": Movability(0, ""), "c": Movability(0, "")}
    judged = TablePrior(embed, table)("near a")
    s_a, s_b = 2 / 5**0.5, 1 / 5**0.5
    assert s_b < prior.NEAR
    assert (judged.rho, judged.source) == (1.0, f"similar to a {s_a:.2f}")
    embed.vectors["near_a"] = [4, 3]
    assert TablePrior(embed, table)("near a").rho == pytest.approx(4 / 7, abs=1e-4)


def test_a_feature_of_zeros_or_nan_is_unknown():
    space = {"a": [1, 0], "b": [-1, 0], "zero": [0, 0], "nan": [np.nan, 0]}
    table = {"a": Movability(1, ""), "b": Movability(0, "")}
    for name in ("zero", "nan"):
        assert TablePrior(FakeEmbedder(**space), table)(name).source == "unknown"


def test_each_label_is_embedded_once_and_the_table_once():
    embed = FakeEmbedder(**SPACE)
    ask = TablePrior(embed, TABLE)
    first = [ask(label) for label in ("beaker", "mug", "Beaker", "song", " song")]
    assert sorted(embed.asked) == ["beaker", "cup", "mug", "song", "wall"]
    assert [ask(label) for label in ("beaker", "mug", "Beaker", "song", " song")] == first


# ---- a language model

HURRIED = Patience(retries=1, backoff_s=0.001, longest_wait_s=0.01, connect_s=2, read_s=0.3)
SAYS_MUCH = {"movability": 0.9}


@pytest.fixture(autouse=True)
def environment(monkeypatch, tmp_path):
    monkeypatch.setenv(KEY, SECRET)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))


def llm(fake, folder, model="a-model"):
    return LlmPrior(Endpoint(fake.url, model, HURRIED), unasked(), folder)


def test_a_model_is_asked_once_a_label(tmp_path):
    with fake_endpoint(says(SAYS_MUCH), says({"movability": 0, "why": "built in"})) as fake:
        ask = llm(fake, tmp_path)
        assert [ask(x) for x in ("Xylophone", "xylophone", "door", "xylophone")] == [
            Movability(0.9, "llm: a-model"),
            Movability(0.9, "llm: a-model"),
            Movability(0.0, "llm: a-model"),
            Movability(0.9, "llm: a-model"),
        ]
    assert [json.loads(a.user.split("? ")[1]) for a in fake.asked] == [{"label": "xylophone"}, {"label": "door"}]
    assert ask.endpoint.cost.requests == 2
    assert ask.endpoint.cost.prompt_tokens == 14


def test_a_thing_without_a_name_is_not_asked_for(tmp_path):
    with fake_endpoint(says(SAYS_MUCH)) as fake:
        assert llm(fake, tmp_path)(" ") == Movability(0.5, "unknown")
    assert not fake.asked


@given(st.text(min_size=1))
def test_any_label_can_be_asked_for(label):
    name = normal(label)
    seen = []
    ask = LlmPrior(FakeModel(seen), lambda n: Movability(0.5, "unknown"), Path(os.devnull))
    assert ask(label).rho == (0.9 if name else 0.5)
    assert all(json.loads(text.split("? ", 1)[1])["label"] == name for text in seen)


class FakeModel:
    """What LlmPrior asks of an Endpoint, without one."""

    where, model = "http://nowhere", "m"

    def __init__(self, seen):
        self.seen = seen

    def ask(self, system, user):
        self.seen.append(user)
        return '{"movability": 0.9}'


MALFORMED = [
    "",
    "0.9",
    "very movable",
    "[0.9]",
    "null",
    "{}",
    '{"movability": "0.9"}',
    '{"movability": true}',
    '{"movability": null}',
    '{"movability": NaN}',
    '{"movability": 1e400}',
    '{"movability": 1.01}',
    '{"movability": -0.1}',
    '{"movability": [0.9]}',
    '{"Movability": 0.9}',
    '```json\n{"movability": 0.9}\n```',
    "[" * 100_000,
]


@pytest.mark.parametrize("answer", MALFORMED, ids=lambda a: a[:30])
def test_a_malformed_answer_is_asked_for_again(answer, tmp_path):
    with fake_endpoint(says(answer), says(SAYS_MUCH)) as fake:
        assert llm(fake, tmp_path)("mug") == Movability(0.9, "llm: a-model")
    first, second = (a.user for a in fake.asked)
    assert second.startswith(first)
    assert len(second) > len(first)


@pytest.mark.parametrize("answer", MALFORMED[:3], ids=lambda a: a[:30])
def test_two_malformed_answers_fall_back_and_are_not_kept(answer, tmp_path):
    with fake_endpoint(says(answer)) as fake:
        assert llm(fake, tmp_path)("mug") == Movability(1.0, "table: AI2-THOR (llm: malformed answer)")
        assert len(fake.asked) == 2
        assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("reply", "why"),
    [
        (Reply(status=500), "status 500"),
        (Reply(status=401), "status 401"),
        (Reply(closes=True), "no answer (ProtocolError)"),
        (Reply(delay_s=0.6), "timed out"),
        (Reply(b"<html>"), "its answer is no JSON"),
    ],
    ids=str,
)
def test_an_endpoint_that_is_down_is_told_and_soon_left_alone(reply, why, tmp_path):
    with fake_endpoint(reply) as fake:
        ask = llm(fake, tmp_path)
        judged = [ask(label) for label in ("mug", "wall", "chair", "cup")]
        assert judged[0] == Movability(1.0, f"table: AI2-THOR (llm: {why})")
        assert judged[1] == Movability(0.0, f"table: vlmm-log (llm: {why})")
        assert [m.source for m in judged[2:]] == ["table: AI2-THOR (llm: not asked after 2 failures in a row)"] * 2
        assert ask.endpoint.cost.requests == prior.FAILURES
        assert list(tmp_path.iterdir()) == []


def test_one_failure_among_answers_is_forgiven(tmp_path):
    bad, good = Reply(status=400), says(SAYS_MUCH)
    with fake_endpoint(bad, good, bad, good) as fake:
        ask = llm(fake, tmp_path)
        told = [ask(label).source for label in ("mug", "cup", "wall", "chair")]
    assert told == [
        "table: AI2-THOR (llm: status 400)",
        "llm: a-model",
        "table: vlmm-log (llm: status 400)",
        "llm: a-model",
    ]


# ---- its answers on disk


def test_an_answer_on_disk_is_not_asked_for(tmp_path):
    with fake_endpoint(says(SAYS_MUCH), says({"movability": 0.1})) as fake:
        assert llm(fake, tmp_path)("Mug").rho == 0.9
        assert llm(fake, tmp_path)("mug") == Movability(0.9, "llm: a-model")
        assert len(fake.asked) == 1
        assert llm(fake, tmp_path, "another")("mug").rho == 0.1  # another model is another question
        assert len(fake.asked) == 2
    assert len(list(tmp_path.iterdir())) == 2
    assert llm(fake, tmp_path)("mug").rho == 0.9  # also where the endpoint is gone


def damaged_files(whole):
    stored = json.loads(whole)
    return {
        "cut": whole[: len(whole) // 2],
        "empty": b"",
        "binary": b"\xff\x00\xfe",
        "deep": b"[" * 100_000,
        "list": b"[1, 2]",
        "answers": json.dumps({**stored, "answers": [0.9]}).encode(),
        "other endpoint": json.dumps({**stored, "endpoint": "http://elsewhere"}).encode(),
        "other prompt": json.dumps({**stored, "prompt": stored["prompt"] + 1}).encode(),
        "no share": json.dumps({**stored, "answers": {"mug": 7, "cup": True, "wall": "0.1"}}).encode(),
        "nan": whole.replace(b"0.9", b"NaN"),
    }


@pytest.mark.parametrize("damage", damaged_files(b'{"prompt": 1, "answers": {"mug": 0.9}}'))
def test_a_damaged_file_is_written_anew(damage, tmp_path):
    with fake_endpoint(says(SAYS_MUCH)) as fake:
        llm(fake, tmp_path)("mug")
        (file,) = tmp_path.iterdir()
        whole = file.read_bytes()
        file.write_bytes(damaged_files(whole)[damage])
        assert llm(fake, tmp_path)("mug") == Movability(0.9, "llm: a-model")
        assert len(fake.asked) == 2
    assert file.read_bytes() == whole
    assert list(tmp_path.iterdir()) == [file]


def test_answers_of_two_runs_at_once_are_all_kept(tmp_path):
    with fake_endpoint(says(SAYS_MUCH)) as fake:
        one, other = llm(fake, tmp_path), llm(fake, tmp_path)
        one("mug"), other("cup"), one("wall")
    (file,) = tmp_path.iterdir()
    assert list(json.loads(file.read_text())["answers"]) == ["cup", "mug", "wall"]


def test_a_folder_that_cannot_be_written_is_told(tmp_path):
    (tmp_path / "file").write_text("in the way")
    with fake_endpoint(says(SAYS_MUCH)) as fake:
        judged = llm(fake, tmp_path / "file/cache")("mug")
    assert judged == Movability(0.9, "llm: a-model (not cached: Not a directory)")


WRITER = """
import sys
from pathlib import Path
from vlmm_log.elements import Movability
from vlmm_log.models.prior import LlmPrior
class Model:
    where, model = "http://nowhere", "m"
    def ask(self, system, user):
        return '{"movability": 0.9}'
ask = LlmPrior(Model(), lambda n: Movability(0.5, "unknown"), Path(sys.argv[1]))
for i in range(100):
    assert ask(f"{sys.argv[2]} {i}").source == "llm: m"
"""


def test_two_processes_do_not_tear_the_file(tmp_path):
    writers = [subprocess.Popen([sys.executable, "-c", WRITER, str(tmp_path), name]) for name in ("a", "b")]
    torn = 0
    while any(w.poll() is None for w in writers):
        for file in tmp_path.glob("*.json"):
            torn += "answers" not in json.loads(file.read_text())
    assert [w.returncode for w in writers] == [0, 0]
    (file,) = tmp_path.iterdir()
    answers = json.loads(file.read_text())["answers"]
    assert torn == 0
    assert {"a 99", "b 99"} & set(answers)
    assert len(answers) >= 100
    assert set(answers.values()) == {0.9}


def test_the_key_is_nowhere_to_be_seen(tmp_path):
    with fake_endpoint(says(SAYS_MUCH), Reply(status=401)) as fake:
        ask = llm(fake, tmp_path)
        told = [ask("mug").source, ask("cup").source, repr(ask), repr(ask.endpoint)]
    assert SECRET in fake.asked[0].headers["Authorization"]
    told += [file.read_text() + file.name for file in tmp_path.iterdir()]
    assert len(told) == 5
    assert SECRET not in "".join(told)


# ---- by settings


def test_the_table_by_settings():
    ask, versions = load_prior(ObjectSettings(), FakeEmbedder())
    assert ask("mug") == Movability(1.0, "table: AI2-THOR")
    assert list(versions) == ["movability table"]
    assert versions["movability table"].startswith("sha256:")


def test_a_model_by_settings(tmp_path):
    with fake_endpoint(says(SAYS_MUCH)) as fake:
        ask, versions = load_prior(ObjectSettings(prior=f"llm:{fake.url}", llm_model="mine"), FakeEmbedder())
        assert ask("mug") == Movability(0.9, "llm: mine")
    assert versions["movability endpoint"] == f"{fake.url} mine prompt {prior.PROMPT}"
    assert len(list((tmp_path / "cache/vlmm-log/movability").iterdir())) == 1


@pytest.mark.parametrize(
    "given", ["", "tabel", "llm", "llm:", "llm:nowhere", "table:x", "llm:ftp://host", "LLM:http://h"]
)
def test_an_unknown_prior_is_told(given):
    with pytest.raises(InputError, match="llm:"):
        load_prior(ObjectSettings(prior=given), FakeEmbedder())


def test_the_table_needs_no_http_client():
    code = "import sys, vlmm_log.models.prior; sys.exit('urllib3' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
