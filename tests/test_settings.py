"""Settings: profiles, TOML there and back, and every way to write one wrong."""

from dataclasses import fields, is_dataclass, replace

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from vlmm_log.settings import PROFILES, Settings
from vlmm_log.types import InputError

KNOWN = [
    f"{table.name}.{f.name}" if is_dataclass(table.default) else table.name
    for table in fields(Settings)
    for f in (fields(table.default) if is_dataclass(table.default) else [table])
]


def get(settings, name):
    for part in name.split("."):
        settings = getattr(settings, part)
    return settings


def fails(*texts, **load):
    """The message with which loading these --set texts fails."""
    with pytest.raises(InputError) as e:
        Settings.load(sets=texts, **load)
    assert "\n" not in str(e.value)
    return str(e.value)


def test_the_default_profile_is_the_plain_settings():
    assert Settings.load() == Settings() == PROFILES["default"]
    assert Settings.load().profile == "default"


def test_the_paper_profile_is_what_the_paper_prints():
    s = Settings.load("paper")
    assert s.profile == "paper"
    assert s.noise.sigma_z_z0 == 0.0004
    assert (s.ego.model, s.ego.inlier) == ("rigid", "metric")
    assert s.gate.depth_band == 0  # depth at b by the nearest pixel
    assert s.noise.sigma_px_first == s.noise.sigma_px_second == 1.5
    assert s.gate.occlusion_sigma == 0
    n = s.noise
    assert {n.fb_variance, n.displacement, n.edge_inflation, n.flow_sigma, n.flow_spread} == {0.0}


def test_no_such_profile():
    message = fails(profile="nope")
    assert "'nope'" in message
    assert "default, paper" in message


def test_every_setting_says_what_it_is_and_its_default_is_allowed():
    for name in KNOWN:
        table, _, leaf = name.rpartition(".")
        owner = get(Settings(), table) if table else Settings()
        assert next(f.metadata["doc"] for f in fields(owner) if f.name == leaf), name
        value = get(Settings(), name)
        if name != "profile":
            text = repr(value).lower() if not isinstance(value, str) else f'"{value}"'
            assert get(Settings.load(sets=[f"{name}={text}"]), name) == value


@pytest.mark.parametrize("profile", PROFILES)
def test_toml_there_and_back(profile, tmp_path):
    path = tmp_path / "s.toml"
    s = Settings.load(profile, sets=["seed=7", "keyframes.gap=0.1s", "log.dense=true", "noise.alpha=1e-9"])
    for each in (PROFILES[profile], s):
        path.write_text(each.to_toml(), "utf-8")
        assert Settings.load(toml=path) == each


@given(st.text(st.characters(exclude_categories=["Cs"])), st.floats(0), st.integers(0))
@example('"\\\x00\x7f\r\n\t', float("inf"), 10**30)
def test_any_value_survives_toml(tmp_path_factory, text, number, whole):
    path = tmp_path_factory.getbasetemp() / "any.toml"
    plain = Settings()
    s = replace(plain, seed=whole, read=replace(plain.read, intrinsics=text, depth_max_m=number))
    path.write_text(s.to_toml(), "utf-8")
    assert Settings.load(toml=path) == s


@pytest.mark.parametrize("name", KNOWN)
@pytest.mark.parametrize("spoil", [lambda n: n + "x", lambda n: n[:2] + n[1:]], ids=["longer", "doubled"])
def test_an_unknown_name_is_told_with_the_nearest(name, spoil):
    table, dot, leaf = name.rpartition(".")
    wrong = table + dot + spoil(leaf)
    if wrong not in KNOWN:
        assert f"no setting {wrong}; nearest is {name}" in fails(f"{wrong}=1")


def test_an_unknown_name_like_no_other_is_told_with_all():
    assert "there are profile, seed, read" in fails("qqqq.gap=1")
    assert "there are stride, gap" in fails("keyframes.qqqq=1")


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("keyframes.stride=1.5", "1.5 is not int"),
        ("keyframes.gap=1.5", "1.5 is not int or str"),
        ("keyframes.gap=true", "True is not int or str"),
        ("keyframes.gap=0", "at least 1"),
        ("query.threshold=-1", "between 0 and 1"),
        ("query.threshold=often", "'often' is not one of auto"),
        ("query.threshold=true", "True is not float or str"),
        ("keyframes=3", "keyframes is a table"),
        ("keyframes.gap.frames=3", "one setting each"),
        ("log.dense=1", "1 is not bool"),
        ("log.dense=yes", "'yes' is not bool"),
        ("noise.alpha=small", "'small' is not float"),
        ("noise.alpha=true", "True is not float"),
        ("noise.alpha=[0.1]", "is not float"),
        ("noise.alpha=", "'' is not float"),
        ("noise.alpha=1", "between 1e-09 and 0.999"),
        ("noise.alpha=nan", "out of range"),
        ("noise.flow_lambda=0", "at least 1e-06"),
        ("read.start_s=1979-05-27", "is not float"),
        ("flow.raft_scale=1.01", "between 0.1 and 1"),
        ("flow.estimator=nope", "'nope' is not one of dis, raft"),
        ("flow.estimator=3", "3 is not str"),
        ("seed=-1", "at least 0"),
        ("seed=true", "True is not int"),
        ("profile=3", "3 is not str"),
    ],
)
def test_a_value_of_the_wrong_type_or_out_of_range_is_told(text, told):
    message = fails(text)
    assert told in message
    assert f"--set {text}" in message


@pytest.mark.parametrize("text", ["", "=", "=3", "keyframes.gap", "keyframes.gap 3", "  =3"])
def test_bad_syntax_is_told_with_the_right_one(text):
    assert "table.name=value" in fails(text)


@pytest.mark.parametrize("text", ["a\nb=1", "a\nb", "flow.estimator='a\\nb'", "seed=x\nseed"])
def test_an_error_is_one_line_whatever_was_typed(text):
    assert fails(text)


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("keyframes.gap=6", 6),
        ("keyframes.gap=0.1s", "0.1s"),
        ("keyframes.gap='0.1s'", "0.1s"),
        (" keyframes.gap = 6 ", 6),
        ("flow.estimator=raft", "raft"),
        (" flow.estimator = raft ", "raft"),
        ("read.intrinsics=525,525,320,240", "525,525,320,240"),
        ("read.intrinsics=a=b", "a=b"),
        ("flow.weights=C:\\w\\raft.pth", "C:\\w\\raft.pth"),
        ("read.depth_max_m=4", 4.0),
        ("noise.alpha=1e-9", 1e-9),
        ("noise.alpha=0.999", 0.999),
        ("log.dense=true", True),
    ],
)
def test_a_set_text(text, value):
    found = get(Settings.load(sets=[text]), text.split("=")[0].strip())
    assert found == value
    assert type(found) is type(value)


def test_later_wins_and_the_rest_stays(tmp_path):
    path = tmp_path / "s.toml"
    path.write_text("seed = 5\n[keyframes]\ngap = 4\nstride = 2\n[noise]\nalpha = 0.01\n")
    s = Settings.load("paper", path, ["keyframes.gap=6", "keyframes.gap=8"])
    assert (s.seed, s.keyframes.gap, s.keyframes.stride, s.noise.alpha) == (5, 8, 2, 0.01)
    assert s.ego == PROFILES["paper"].ego


def test_a_toml_file_may_name_the_profile(tmp_path):
    path = tmp_path / "s.toml"
    path.write_text('profile = "paper"\n[noise]\nalpha = 0.1\n')
    paper = PROFILES["paper"]
    assert Settings.load(toml=path) == replace(paper, noise=replace(paper.noise, alpha=0.1))


@pytest.mark.parametrize(
    ("content", "told"),
    [
        (bytes(range(256)), "not a TOML file"),
        (b"\x89PNG\r\n\x1a\n\x00\x00", "not a TOML file"),
        (b"keyframes.gap", "not a TOML file"),
        (b"[keyframes]\ngapp = 3\n", "nearest is keyframes.gap"),
        (b"[keyframes]\ngap = []\n", "keyframes.gap: [] is not int or str"),
        (b"keyframes = 3\n", "keyframes is a table"),
        (b'profile = "nope"\n', "no such profile"),
        (b"profile = 3\n", "3 is not str"),
        (None, "cannot read the settings"),
    ],
)
def test_a_bad_toml_file_is_told_by_its_path(tmp_path, content, told):
    path = tmp_path / "s.toml"
    if content is not None:
        path.write_bytes(content)
    message = fails(toml=path)
    assert told in message
    assert str(path) in message or "nope" in message


words = ["nan", "-inf", "inf", "1e999", "0x10", "1_000", "'''", "[[", "{a=1}", "07:32:00", "9" * 300]
values = st.one_of(st.text(), st.sampled_from(words), st.floats().map(str), st.integers().map(str))


@given(st.one_of(st.text(), st.builds("{}={}".format, st.sampled_from(KNOWN), values)))
def test_arbitrary_text_works_or_is_an_input_error(text):
    try:
        assert isinstance(Settings.load(sets=[text]), Settings)
    except InputError as e:
        assert " ".join(text.partition("=")[0].splitlines()).strip()[:20] in str(e)


@pytest.mark.parametrize(
    "text",
    [
        pytest.param("noise.alpha=" + "9" * 400, id="too large for a float"),
        pytest.param("seed=" + "9" * 5000, id="more digits than Python reads"),
        pytest.param("seed=" + "[" * 2000, id="nested too deep"),
        pytest.param("seed" + ".a" * 2000 + "=1", id="name nested too deep"),
    ],
)
def test_an_absurd_text_is_an_input_error(text):
    with pytest.raises(InputError):
        Settings.load(sets=[text])


def test_a_profile_may_be_named_once():
    assert Settings.load(sets=["profile=paper"]) == Settings.load("paper")
    assert "another one says 'default'" in fails_with("default", "profile=paper")


def fails_with(profile, text):
    with pytest.raises(InputError) as e:
        Settings.load(profile, sets=[text])
    return str(e.value)
