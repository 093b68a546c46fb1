"""The language-model endpoint: what is retried, refused and counted; the key never shows. The query parser on it."""

import json
import logging
import re
import time
import traceback
from dataclasses import fields, replace

import pytest
from hypothesis import given
from hypothesis import strategies as st
from own_log import OwnLog, own_frames, room_depth
from small_room import write_masks

import vlmm_log
from fake_endpoint import Reply, fake_endpoint, says
from tum_folder import write_tum_folder
from vlmm_log.models.endpoint import KEY, LARGEST, Cost, Endpoint, EndpointError, Patience
from vlmm_log.models.llm_parser import EXAMPLES, FORM, PROMPT, LlmParser
from vlmm_log.pipeline.language.parser import parse
from vlmm_log.pipeline.language.router import route
from vlmm_log.queries import RETURNS, Order, Query, to_json
from vlmm_log.query_tree import (
    CLASSES,
    FIELDS,
    KINDS,
    OPS,
    RELATIONS,
    AllOf,
    AnyOf,
    Class,
    Compare,
    Movable,
    Moved,
    Named,
    Near,
    Not,
    Seen,
    Side,
)
from vlmm_log.recording import open_recording
from vlmm_log.settings import Settings
from vlmm_log.types import InputError

SECRET = "sk-do-not-tell-1234"
HURRIED = Patience(retries=2, backoff_s=0.001, longest_wait_s=0.01, connect_s=2, read_s=0.3)


@pytest.fixture(autouse=True)
def key(monkeypatch):
    monkeypatch.setenv(KEY, SECRET)


def ask(fake, patience=HURRIED):
    endpoint = Endpoint(fake.url, "a-model", patience)
    return endpoint.ask("Be brief.", "Mug?"), endpoint.cost


def fails(fake, patience=HURRIED):
    """The error and the cost of asking an endpoint that fails."""
    endpoint = Endpoint(fake.url, "a-model", patience)
    with pytest.raises(EndpointError) as e:
        endpoint.ask("Be brief.", "Mug?")
    told = str(e.value)
    assert "\n" not in told
    assert told.startswith(fake.url + ": ")
    assert SECRET not in "".join(traceback.format_exception(e.value))
    return told, endpoint.cost


def test_what_is_asked_and_what_it_costs():
    with fake_endpoint(says("first", 11, 2), says("second", 5, 1)) as fake:
        endpoint = Endpoint(fake.url + "/", "a-model")
        assert [endpoint.ask("Be brief.", "Mug?"), endpoint.ask("Be brief.", "Wall?")] == ["first", "second"]
    assert endpoint.cost == Cost(requests=2, retries=0, prompt_tokens=16, completion_tokens=3)
    asked = fake.asked[0]
    assert asked.path == "/v1/chat/completions"
    assert asked.headers["Authorization"] == f"Bearer {SECRET}"
    assert asked.headers["Content-Type"] == "application/json"
    assert asked.body == {
        "model": "a-model",
        "messages": [{"role": "system", "content": "Be brief."}, {"role": "user", "content": "Mug?"}],
        "temperature": 0,
        "seed": 0,
        "response_format": {"type": "json_object"},
    }


def test_a_whole_url_is_taken_as_it_is():
    with fake_endpoint(says("yes")) as fake:
        assert Endpoint(fake.url + "/chat/completions", "m").ask("", "") == "yes"
    assert fake.asked[0].path == "/v1/chat/completions"


def test_no_key_no_header(monkeypatch):
    monkeypatch.setenv(KEY, " ")
    with fake_endpoint(says("yes")) as fake:
        ask(fake)
    assert "Authorization" not in fake.asked[0].headers


@pytest.mark.parametrize("bad", [Reply(status=s) for s in (429, 500, 502, 503, 504)] + [Reply(closes=True)], ids=str)
def test_what_may_pass_is_tried_again(bad):
    with fake_endpoint(bad, bad, says("yes")) as fake:
        answer, cost = ask(fake)
    assert (answer, cost.requests, cost.retries, len(fake.asked)) == ("yes", 1, 2, 3)


def test_half_an_answer_is_tried_again():
    with fake_endpoint(Reply(b"{", told_length=100), says("yes")) as fake:
        assert ask(fake)[0] == "yes"


def test_retry_after_is_honoured_up_to_a_limit():
    with fake_endpoint(Reply(status=429, headers={"Retry-After": "1"}), says("yes")) as fake:
        start = time.monotonic()
        assert ask(fake, Patience(backoff_s=0, longest_wait_s=5))[0] == "yes"
        assert time.monotonic() - start >= 1
    for far in ("3600", "Fri, 31 Dec 2999 23:59:59 GMT"):
        with fake_endpoint(Reply(status=429, headers={"Retry-After": far}), says("yes")) as fake:
            start = time.monotonic()
            assert ask(fake)[0] == "yes"
            assert time.monotonic() - start < 1


@pytest.mark.parametrize("wrong", ["soon", "9" * 5000])
def test_a_retry_after_that_is_no_time_is_told(wrong):
    with fake_endpoint(Reply(status=429, headers={"Retry-After": wrong})) as fake:
        assert "Retry-After is no time" in fails(fake)[0]


@pytest.mark.parametrize(
    ("reply", "told"),
    [
        (Reply(status=500), "status 500; check the endpoint"),
        (Reply(b"no more", status=500, told_length=10**12), "status 500; check the endpoint"),
        (Reply(status=429), "status 429; wait, or check the quota"),
        (Reply(closes=True), "no answer (ProtocolError)"),
        (Reply(b"{", told_length=100), "no answer (ProtocolError)"),
    ],
    ids=str,
)
def test_what_does_not_pass_is_told_after_all_retries(reply, told):
    with fake_endpoint(reply) as fake:
        message, cost = fails(fake)
    assert told in message
    assert cost == Cost(requests=1, retries=HURRIED.retries)
    assert len(fake.asked) == 1 + HURRIED.retries


@pytest.mark.parametrize(
    ("reply", "told"),
    [
        (Reply(delay_s=1), "timed out"),  # it had its time
        (Reply(status=400), "status 400"),
        (Reply(status=401), f"status 401; check {KEY}"),
        (Reply(status=404), "status 404; check the URL and objects.llm_model"),
        (Reply(status=204), "status 204"),
        (Reply(b""), "no JSON"),
        (Reply(b"<html><body>Welcome</body></html>", headers={"Content-Type": "text/html"}), "no JSON"),
        (Reply(b"\xff\xfe\x00"), "no JSON"),
        (Reply(b"[" * 100_000), "no JSON"),
        (Reply(b'{"choices": NaN}'), "no JSON"),
        (Reply(b"[]"), "no chat completion"),
        (Reply(b"null"), "no chat completion"),
        (Reply(b'{"choices": []}'), "no chat completion"),
        (Reply(b'{"choices": [{"message": {"content": null}}]}'), "no chat completion"),
        (Reply(b'{"choices": {"0": {"message": {"content": "x"}}}}'), "no chat completion"),
        (Reply(b'{"error": {"message": "sk-do-not-tell-1234 is no key"}}'), "no chat completion"),
        (Reply(b" " * (LARGEST + 1)), f"longer than {LARGEST} bytes"),
        (Reply(b" ", told_length=10**12), f"longer than {LARGEST} bytes"),
        (Reply(b"x" * (LARGEST + 1), headers={"Content-Encoding": "gzip"}), f"longer than {LARGEST} bytes"),
    ],
    ids=lambda x: x if isinstance(x, str) else f"{x.status} {x.body[:40]}",
)
def test_an_answer_that_cannot_be_used_is_not_tried_again(reply, told):
    with fake_endpoint(reply) as fake:
        message, cost = fails(fake)
    assert told in message
    assert (cost.retries, len(fake.asked)) == (0, 1)


def test_a_redirect_is_not_followed_with_the_key():
    with fake_endpoint(says("stolen")) as elsewhere:
        moved = Reply(status=307, headers={"Location": elsewhere.url + "/chat/completions"})
        with fake_endpoint(moved) as fake:
            assert "redirects are not followed" in fails(fake)[0]
        assert not elsewhere.asked


def test_nobody_there():
    with fake_endpoint(says("yes")) as fake:
        pass
    assert "cannot be reached" in fails(fake)[0]


@pytest.mark.parametrize("usage", [None, [], {"prompt_tokens": "many", "completion_tokens": 1}, {"prompt_tokens": -5}])
def test_usage_that_is_no_count_costs_nothing(usage):
    reply = Reply(json.dumps({"choices": [{"message": {"content": "yes"}}], "usage": usage}).encode())
    with fake_endpoint(reply) as fake:
        assert ask(fake) == ("yes", Cost(requests=1))


@pytest.mark.parametrize(
    "url",
    [
        "",
        "localhost",
        "ftp://host/v1",
        "file:///etc/hostname",
        "http://",
        "http://host:x/v1",
        "http://[::1/v1",
        "http://ho st/v1",
        "http://host/v1\n",
        "http://hôst/v1",
    ],
)
def test_what_is_no_url(url):
    with pytest.raises(InputError, match="llm:http://localhost"):
        Endpoint(url, "m")


@pytest.mark.parametrize("tail", ["user:{}@host/v1", "host/v1?key={}", "host/v1#{}"])
def test_a_url_that_holds_a_secret_is_refused_and_not_told(tail):
    with pytest.raises(InputError, match=KEY) as e:
        Endpoint("https://" + tail.format(SECRET), "m")
    assert SECRET not in str(e.value)


@pytest.mark.parametrize(
    ("url", "is_sent"),
    [
        ("https://api.example.com/v1", True),
        ("http://localhost:11434/v1", True),
        ("http://127.8.9.1/v1", True),
        ("http://[::1]:80/v1", True),
        ("http://api.example.com/v1", False),
        ("http://192.168.1.5/v1", False),
        ("http://localhost.example.com/v1", False),
        ("http://127.0.0.1.example.com/v1", False),
    ],
)
def test_the_key_goes_over_plain_http_only_to_this_machine(url, is_sent, monkeypatch):
    if is_sent:
        Endpoint(url, "m")
        return
    with pytest.raises(InputError, match="plain http") as e:
        Endpoint(url, "m")
    assert SECRET not in str(e.value)
    monkeypatch.delenv(KEY)
    Endpoint(url, "m")


def test_a_key_that_no_header_may_hold_is_refused(monkeypatch):
    monkeypatch.setenv(KEY, "sk-one\r\nHost: elsewhere")
    with pytest.raises(InputError, match=KEY) as e:
        Endpoint("https://host/v1", "m")
    assert "sk-one" not in str(e.value)


def test_the_key_is_nowhere_to_be_seen(caplog):
    caplog.set_level(logging.DEBUG)
    with fake_endpoint(Reply(status=500), says("yes")) as fake:
        endpoint = Endpoint(fake.url, "a-model", HURRIED)
        endpoint.ask("Be brief.", "Mug?")
    assert SECRET in fake.asked[0].headers["Authorization"]
    assert SECRET not in repr(endpoint) + str(endpoint) + repr(endpoint.cost) + caplog.text


def test_what_an_endpoint_repeats_of_the_key_is_left_out():
    with fake_endpoint(says(f"with {SECRET}: yes")) as fake:
        assert ask(fake)[0] == "with [key]: yes"
    with fake_endpoint(says({"filter": {"type": SECRET}})) as fake, pytest.raises(InputError) as e:
        LlmParser(Endpoint(fake.url, "a-model", HURRIED))("a chair")
    assert SECRET not in "".join(traceback.format_exception(e.value))
    assert SECRET not in fake.asked[1].user


def test_a_word_that_local_endpoints_take_for_a_key_is_left_in_answers(monkeypatch):
    monkeypatch.setenv(KEY, "ollama")
    with fake_endpoint(says("ollama says yes")) as fake:
        assert ask(fake)[0] == "ollama says yes"


WITH_SECRET = [f"llm:https://user:{SECRET}@host/v1", f"llm:https://host/v1?api_key={SECRET}", f"https://{SECRET}@host"]


@pytest.mark.parametrize("url", [*WITH_SECRET, f"llm:https://host/v1#{SECRET}", f"LLM:http://u:p@{SECRET}@h:x/v1"])
@pytest.mark.parametrize(
    "name", ["objects.prior", "query.parser", "objects.priro", "flow.estimator", "objects.embedder"]
)
def test_secrets_of_urls_are_in_no_error(name, url, tmp_path):
    with pytest.raises(InputError) as e:
        s = Settings.load(sets=[f"{name}={url}"])
        vlmm_log.process(OwnLog(own_frames()), settings=s, queries=["what moved"], rrd=tmp_path / "a.rrd")
    assert SECRET not in "".join(traceback.format_exception_only(e.value))
    assert not list(tmp_path.iterdir())


def held(folder):
    """All bytes of all files below, and their names; of recordings the values, too, as they are compressed."""
    from rerun.chunk import RrdReader

    files = [p for p in folder.rglob("*") if p.is_file()]
    values = [repr([c.to_record_batch().to_pydict() for c in RrdReader(str(p)).stream()]) for p in folder.glob("*.rrd")]
    read = [open_recording(p) for p in folder.glob("*.mcap")]
    values += [repr((r.run, list(r.entries(r.entities)))) for r in read]
    return b"".join(p.read_bytes() + str(p).encode() for p in files) + "".join(values).encode()


def test_a_run_that_asks_an_endpoint_leaves_the_key_nowhere(tmp_path, caplog, monkeypatch):
    monkeypatch.setattr("vlmm_log.models.prior.user_cache", lambda: tmp_path / "cache/features")
    caplog.set_level(logging.DEBUG)
    (tmp_path / "masks").mkdir()
    write_masks(tmp_path / "masks", {k: (room_depth() < 2) for k in range(3)})
    (tmp_path / "masks/labels.txt").write_text("1 gizmo\n")
    moved = to_json(Query(AllOf(), text="x"))
    with fake_endpoint(
        lambda asked: says(moved if "query" in asked.user else {"movability": 0.9, "echo": SECRET})
    ) as fake:
        sets = [f"objects.prior=llm:{fake.url}", f"query.parser=llm:{fake.url}", "keyframes.gap=1"]
        s = Settings.load(sets=[*sets, f"objects.segmenter=masks:{tmp_path / 'masks'}"])
        outputs = {name: tmp_path / f"a.{name}" for name in ("rrd", "mcap")}
        done = vlmm_log.process(OwnLog(own_frames()), settings=s, queries=["what"], map=tmp_path / "a.json", **outputs)
        other = vlmm_log.process(OwnLog(own_frames(4)), settings=s, rrd=tmp_path / "b.rrd")
        told = {name: tmp_path / f"d.{name}" for name in ("html", "json", "rrd")}
        vlmm_log.diff(tmp_path / "a.rrd", other.outputs[0], **told)
    assert {a.headers["Authorization"] for a in fake.asked} == {f"Bearer {SECRET}"}
    assert "movability endpoint" in done.run.versions and done.answers
    told = held(tmp_path)
    assert fake.url.encode() in told and b"cache" in told
    assert SECRET.encode() not in told and SECRET not in caplog.text + repr(done)


def test_a_batch_writes_no_secret_of_a_url(tmp_path):
    log = write_tum_folder(tmp_path / "logs/log", frames=5)
    s = Settings.load(sets=[f"objects.prior={WITH_SECRET[0]}"])
    done = vlmm_log.batch([log], tmp_path / "out", settings=s, workers=1)
    assert [str(o.state) for o in done.outcomes] == ["failed"]
    told = held(tmp_path)
    assert b"the key comes from" in told and SECRET.encode() not in told


# ---- the language model as the query parser

numbers = st.floats(-1e6, 1e6)
spans = st.tuples(st.none() | st.floats(0, 10), st.none() | st.floats(10, 20))
leaves = st.one_of(
    st.text(min_size=1, max_size=20).filter(str.strip).map(Named),
    spans.map(lambda t: Moved(*t)),
    spans.map(lambda t: Seen(*t)),
    st.just(Movable()),
    st.sampled_from(CLASSES).map(Class),
    st.builds(Compare, st.sampled_from(FIELDS), st.sampled_from(OPS), numbers),
)
nodes = st.recursive(
    leaves,
    lambda inner: st.one_of(
        st.lists(inner, max_size=3).map(tuple).map(AllOf),
        st.lists(inner, max_size=3).map(tuple).map(AnyOf),
        inner.map(Not),
        st.builds(Near, st.none() | inner, st.none() | st.floats(0, 9)),
        st.builds(Side, st.sampled_from(RELATIONS), st.none() | inner),
    ),
    max_leaves=8,
)
orders = st.builds(Order, st.sampled_from(FIELDS), st.sampled_from(["most", "least"]))
orders |= st.builds(Order, st.just("distance_m"), st.just("least"), nodes)
queries = st.builds(
    Query,
    nodes,
    st.none() | orders,
    st.none() | st.integers(1, 100),
    st.sampled_from(RETURNS),
    unparsed=st.lists(st.text(max_size=9), max_size=2).map(tuple),
)


class FakeModel:
    """What LlmParser asks of an Endpoint, without one."""

    where = "http://nowhere"

    def __init__(self, *answers):
        self.answers, self.asked = list(answers), []

    def ask(self, system, user):
        self.asked.append(user)
        return self.answers.pop(0)


@given(queries, st.text(min_size=1, max_size=100).filter(str.strip))
def test_any_query_comes_through_with_the_users_own_words(query, text):
    model = FakeModel(to_json(replace(query, text="other words")))
    assert LlmParser(model)(text) == replace(query, text=text)
    assert [json.loads(asked) for asked in model.asked] == [{"query": text}]


ASKED = [
    "the door that opens",
    "things I could move",
    "where it stays still",
    "things that never move except chairs",
    "the three fastest cups or mugs left of the monitor within 1 m of the door",
    "how many people moved between 10 s and 12 s",
]


@pytest.mark.parametrize("parser", [parse, route])
def test_queries_of_the_other_parsers_come_through_the_endpoint(parser):
    with fake_endpoint(lambda asked: says(to_json(parser(json.loads(asked.user)["query"])))) as fake:
        ask = LlmParser(Endpoint(fake.url, "a-model", HURRIED))
        assert [ask(text) for text in ASKED] == [parser(text) for text in ASKED]
    assert ask.endpoint.cost == Cost(len(ASKED), 0, 7 * len(ASKED), 3 * len(ASKED))


def test_the_prompt_names_all_that_a_query_may_hold():
    for name in (*KINDS, *RELATIONS, *CLASSES, *FIELDS, *RETURNS, *(f.name for f in fields(Query) if f.name != "text")):
        assert re.search(rf"\b{name}\b", FORM), name
    assert len(EXAMPLES) == 3
    for text, query in EXAMPLES.items():
        assert json.dumps({"query": text}) + "\n" + to_json(query) in PROMPT


@pytest.mark.parametrize(
    ("wrong", "told"),
    [
        ("a chair", "not JSON"),
        ("[]", "not an object"),
        ("{}", "lacks filter"),
        ('{"filter": {"type": "chair"}}', "not an object with a type"),
        ('{"filter": {"type": "compare", "field": "colour", "op": ">", "value": 1}}', "colour"),
        ('{"filter": {"type": "compare", "field": "o", "op": ">", "value": NaN}}', "NaN"),
        ('{"filter": {"type": "movable"}, "limit": -1}', "limit"),
    ],
)
def test_an_answer_that_is_no_query_is_asked_for_again_with_what_is_wrong(wrong, told):
    right = Query(Movable(), text="what can I carry?")
    with fake_endpoint(says(wrong), says(to_json(right)), says(wrong)) as fake:
        ask = LlmParser(Endpoint(fake.url, "a-model", HURRIED))
        assert ask("what can I carry?") == right
        first, second = (a.user for a in fake.asked)
        assert second.startswith(first)
        assert told in second
        with pytest.raises(InputError, match="no query twice") as e:
            ask("what can I carry?")
    assert told in str(e.value)
    assert "query.parser=default" in str(e.value)
    assert len(fake.asked) == 4


def test_an_endpoint_that_is_down_parses_nothing():
    with fake_endpoint(Reply(status=401)) as fake, pytest.raises(EndpointError, match="status 401"):
        LlmParser(Endpoint(fake.url, "a-model", HURRIED))("the door")
    assert len(fake.asked) == 1


@pytest.mark.parametrize("text", ["", " \n", "door " * 300])
def test_what_cannot_be_asked_is_not_sent(text):
    model = FakeModel()
    with pytest.raises(InputError, match="query:"):
        LlmParser(model)(text)
    assert not model.asked
