"""Sequences fetched from a site on the loopback: gone on with, verified, unpacked safely; the list asks nobody."""

import gzip
import hashlib
import io
import json
import re
import stat
import tarfile
import zipfile
from dataclasses import replace

import pytest
from command_line import command, no_network

from fake_site import Served, fake_site
from tum_folder import CAMERA, write_tum_folder
from vlmm_log.datasets import datasets, get_dataset
from vlmm_log.store import archives
from vlmm_log.store.archives import unpack
from vlmm_log.store.download import Patience, check_url
from vlmm_log.store.offers import Offer, datasets_on_offer, named
from vlmm_log.survey import info
from vlmm_log.types import InputError

HURRIED = Patience(tries=3, wait_s=0.001, connect_s=2, read_s=2)
ONCE = replace(HURRIED, tries=1)
NAME = "rgbd_dataset_room"


@pytest.fixture(scope="module")
def packed(tmp_path_factory):
    """A small log in TUM layout as a .tgz and as a .zip."""
    folder = write_tum_folder(tmp_path_factory.mktemp("packed") / NAME, camera=CAMERA)
    tgz, zipped = io.BytesIO(), io.BytesIO()
    with tarfile.open(fileobj=tgz, mode="w:gz") as tar:
        tar.add(folder, NAME)
    with zipfile.ZipFile(zipped, "w") as archive:
        for path in sorted(folder.rglob("*")):
            archive.write(path, f"{NAME}/{path.relative_to(folder)}")
    return {".tgz": tgz.getvalue(), ".zip": zipped.getvalue()}


@pytest.fixture
def site(packed):
    with fake_site() as site:
        site.files = {f"/{NAME}{suffix}": Served(body) for suffix, body in packed.items()}
        yield site


def offer_of(site, suffix=".tgz", **known):
    file = NAME + suffix
    offer = Offer("room", file, f"{site.url}/{file}", "Rooms", "https://rooms.org", "CC0", "N. N. 2026", folder=NAME)
    return replace(offer, **known)


def get(site, folder, suffix=".tgz", patience=HURRIED, known=(), **options):
    told = []
    offer = offer_of(site, suffix, **dict(known))
    got = get_dataset("room", to=folder, offers=[offer], patience=patience, tell=told.append, **options)
    return got, told


def refused(site, folder, *args, **options):
    with pytest.raises(InputError) as e:
        get(site, folder, *args, **options)
    return str(e.value)


def names(folder):
    return sorted(p.name for p in folder.iterdir()) if folder.exists() else []


def sha256(data):
    return hashlib.sha256(data).hexdigest()


@pytest.mark.parametrize("suffix", [".tgz", ".zip"])
def test_a_sequence_comes_whole_and_is_read(site, packed, tmp_path, suffix):
    seen = []
    got, told = get(site, tmp_path, suffix, progress=lambda done, expected: seen.append((done, expected)))
    assert info(got.path).frames == 4
    assert (got.path, got.outside, told) == (tmp_path / NAME, 0, [])
    assert seen
    assert names(tmp_path) == [NAME, f"{NAME}{suffix}.sha256"]
    headers = {name.lower() for _, headers in site.asked for name in headers}
    assert not headers & {"authorization", "cookie", "range"}


def test_a_cut_download_is_gone_on_with(site, packed, tmp_path):
    body = packed[".tgz"]
    site.files[f"/{NAME}.tgz"].cuts = [1000]
    line = refused(site, tmp_path, patience=ONCE)
    assert "the connection was cut; 0.0 MB are kept, the same command goes on" in line
    assert (tmp_path / f"{NAME}.tgz.partial").read_bytes() == body[:1000]
    (shelved,) = datasets(tmp_path, offers=[offer_of(site)])
    assert (shelved.state, shelved.size) == ("begun", 1000)
    got, told = get(site, tmp_path)
    assert [headers.get("Range") for _, headers in site.asked] == [None, "bytes=1000-"]
    assert site.asked[1][1]["If-Range"] == '"1"'
    assert (got.sha256, told) == (sha256(body), [])
    assert names(tmp_path) == [NAME, f"{NAME}.tgz.sha256"]


def test_one_command_goes_on_by_itself_after_cuts_and_busy_servers(site, packed, tmp_path):
    site.files[f"/{NAME}.tgz"].cuts = [100, 200]
    got, _ = get(site, tmp_path)
    assert [headers.get("Range") for _, headers in site.asked] == [None, "bytes=100-", "bytes=300-"]
    assert got.sha256 == sha256(packed[".tgz"])
    site.files[f"/{NAME}.zip"].status = [503, 0]
    assert get(site, tmp_path / "b", ".zip")[0].path.is_dir()


@pytest.mark.parametrize("compares", [True, False])
def test_a_file_that_changed_meanwhile_is_not_mixed(site, packed, tmp_path, compares):
    served = site.files[f"/{NAME}.tgz"]
    changed = packed[".tgz"]
    served.body, served.cuts = b"\0" * len(changed), [1000]
    refused(site, tmp_path, patience=ONCE)
    served.body, served.tag, served.compares = changed, '"2"', compares
    got, told = get(site, tmp_path)
    assert told == ["the file there is not the one that was begun: from the start"]
    assert got.sha256 == sha256(changed)


def test_a_file_that_shrank_is_not_mixed(site, packed, tmp_path):
    served = site.files[f"/{NAME}.tgz"]
    served.body, served.cuts = b"\0" * 3 * len(packed[".tgz"]), [2 * len(packed[".tgz"])]
    refused(site, tmp_path, patience=ONCE)
    served.body, served.compares = packed[".tgz"], False  # it answers 416
    assert get(site, tmp_path)[0].sha256 == sha256(packed[".tgz"])


@pytest.mark.parametrize(
    ("served", "line"),
    [
        ({"ranges": False}, "the server cannot go on in the middle: from the start"),
        ({"tag": ""}, "of what was begun it is not known whether it is still the same: from the start"),
        ({"tag": 'W/"1"'}, "of what was begun it is not known whether it is still the same: from the start"),
    ],
)
def test_a_server_without_ranges_or_validators_starts_over(site, packed, tmp_path, served, line):
    site.files[f"/{NAME}.tgz"] = Served(packed[".tgz"], cuts=[1000], **served)
    got, told = get(site, tmp_path)
    assert told == [line]
    assert got.sha256 == sha256(packed[".tgz"])


def test_a_date_serves_for_a_missing_tag(site, packed, tmp_path):
    date = "Tue, 07 Aug 2012 18:50:52 GMT"
    served = Served(packed[".tgz"], tag="", cuts=[1000], compares=False, headers={"Last-Modified": date})
    site.files[f"/{NAME}.tgz"] = served
    assert get(site, tmp_path)[1] == []
    assert site.asked[1][1]["If-Range"] == date


def test_a_whole_beginning_is_not_asked_for_again(site, packed, tmp_path):
    site.files[f"/{NAME}.tgz"].cuts = [1000]
    refused(site, tmp_path, patience=ONCE)
    (tmp_path / f"{NAME}.tgz.partial").write_bytes(packed[".tgz"])  # killed before it was renamed
    get(site, tmp_path)
    assert len(site.asked) == 1


def test_the_first_download_is_recorded_and_kept_to(site, packed, tmp_path):
    got, _ = get(site, tmp_path)
    record = tmp_path / f"{NAME}.tgz.sha256"
    assert got.source == ""
    assert f"{sha256(packed['.tgz'])}  {NAME}.tgz" in record.read_text().splitlines()
    assert f"# {len(packed['.tgz'])} bytes from {site.url}/{NAME}.tgz" in record.read_text()
    assert get(site, tmp_path, force=True)[0].source == "the first download"
    site.files[f"/{NAME}.tgz"].body = gzip.compress(gzip.decompress(packed[".tgz"]), 1)
    line = refused(site, tmp_path, force=True)
    assert "came with another SHA-256 than the first download says; nothing was kept" in line
    assert info(tmp_path / NAME).frames == 4
    assert names(tmp_path) == [NAME, record.name]
    new = sha256(site.files[f"/{NAME}.tgz"].body)
    assert get(site, tmp_path, force=True, sha256=new.upper())[0].sha256 == new


def test_a_known_hash_is_asked_of_what_comes(site, packed, tmp_path):
    known = {"sha256": sha256(packed[".tgz"])}
    assert get(site, tmp_path / "a", known=known)[0].source == "the list"
    assert names(tmp_path / "a") == [NAME]  # nothing to record
    line = refused(site, tmp_path / "b", known={"sha256": "0" * 64})
    assert "another SHA-256 than the list says" in line
    assert names(tmp_path / "b") == []
    assert "another SHA-256 than --sha256 says" in refused(site, tmp_path / "b", known=known, sha256="1" * 64)
    asked = len(site.asked)
    assert "is no SHA-256" in refused(site, tmp_path / "b", sha256="12")
    (tmp_path / f"b/{NAME}.tgz.sha256").write_text("what?")
    assert "holds no hash" in refused(site, tmp_path / "b")
    assert len(site.asked) == asked


def test_what_cannot_be_unpacked_is_not_trusted(site, tmp_path):
    site.files[f"/{NAME}.tgz"].body = b"<html>moved</html>" * 100
    line = refused(site, tmp_path)
    assert "is broken" in line
    assert names(tmp_path) == [f"{NAME}.tgz"]


def test_an_archive_that_lies_there_is_used_and_kept(site, packed, tmp_path):
    (tmp_path / f"{NAME}.zip").write_bytes(packed[".zip"])
    assert datasets(tmp_path, offers=[offer_of(site, ".zip")])[0].state == "archive"
    get(site, tmp_path, ".zip")
    assert site.asked == []
    assert names(tmp_path) == [NAME, f"{NAME}.zip", f"{NAME}.zip.sha256"]
    line = refused(site, tmp_path, ".zip", sha256="0" * 64, force=True)
    assert "lies there with another SHA-256 than --sha256 says; remove it" in line
    assert (tmp_path / f"{NAME}.zip").read_bytes() == packed[".zip"]
    get(site, tmp_path / "b", keep_archive=True)
    assert f"{NAME}.tgz" in names(tmp_path / "b")


def test_an_existing_folder_is_replaced_only_on_request(site, tmp_path):
    (tmp_path / NAME).mkdir()
    (tmp_path / NAME / "rgb.txt").write_text("mine")
    assert f"{NAME}: exists; give --force" in refused(site, tmp_path)
    assert site.asked == []
    assert (tmp_path / NAME / "rgb.txt").read_text() == "mine"
    get(site, tmp_path, force=True)
    assert info(tmp_path / NAME).frames == 4


@pytest.mark.parametrize(
    ("served", "line"),
    [
        (Served(status=[404]), "is not there any more (status 404); give its new place with --url"),
        (Served(status=[403]), "status 403; look at it in a browser"),
        (Served(status=[500]), "status 500; try again later"),
        (Served(b"<p>", headers={"Content-Type": "text/html"}), "answers with a web page, not with a file"),
        (Served(status=[302], headers={"Location": "http://example.org/a.tgz"}), "http://example.org: only https"),
        (Served(status=[302], headers={"Location": "file:///etc/passwd"}), "only https is asked"),
        (Served(status=[302], headers={"Location": "https://a:b@example.org/"}), "may hold no user or password"),
        (Served(status=[302], headers={"Location": f"/{NAME}.tgz"}), "leads to more than 5 other places"),
    ],
)
def test_what_a_server_refuses_is_told_in_a_line(site, tmp_path, served, line):
    site.files[f"/{NAME}.tgz"] = served
    assert line in refused(site, tmp_path)
    assert names(tmp_path) in ([], [f"{NAME}.tgz.partial"])
    if served.status != [500]:
        assert len(site.asked) == (6 if "Location" in served.headers and "/rgbd" in served.headers["Location"] else 1)


def test_a_refusal_does_not_cost_what_was_begun(site, packed, tmp_path):
    served = site.files[f"/{NAME}.tgz"]
    served.cuts = [1000]
    refused(site, tmp_path, patience=ONCE)
    for other in (Served(status=[404]), Served(b"<p>", headers={"Content-Type": "text/html"})):
        site.files[f"/{NAME}.tgz"] = other
        refused(site, tmp_path)
        assert (tmp_path / f"{NAME}.tgz.partial").stat().st_size == 1000


def test_a_redirect_is_followed_and_goes_on(site, packed, tmp_path):
    site.files["/moved.tgz"] = Served(packed[".tgz"], cuts=[1000])
    site.files[f"/{NAME}.tgz"] = Served(status=[302], headers={"Location": "/moved.tgz"})
    get(site, tmp_path)
    assert [path for path, _ in site.asked] == [f"/{NAME}.tgz", "/moved.tgz"] * 2
    got, _ = get(site, tmp_path / "b", url=f"{site.url}/moved.tgz")
    assert got.offer.url == f"{site.url}/moved.tgz"


def test_what_is_too_long_is_given_up(site, packed, tmp_path):
    line = refused(site, tmp_path, known={"size": 1000})
    assert "more than the 0 MB that are expected at most" in line
    site.files[f"/{NAME}.tgz"].headers = {"Content-Length": "", "Transfer-Encoding": "identity"}
    assert "sends more than" in refused(site, tmp_path / "b", known={"size": 1000})
    assert (tmp_path / f"b/{NAME}.tgz.partial").stat().st_size == 0


def test_two_at_a_time_do_not_mix(site, tmp_path):
    from vlmm_log.store.download import _held

    with _held(tmp_path / f"{NAME}.tgz.partial"):
        assert "another download writes to it" in refused(site, tmp_path)


@pytest.mark.parametrize(
    "url", ["http://example.org/a", "ftp://127.0.0.1/a", "https://u:p@example.org/a", "https:///a", "https://[/", "a b"]
)
def test_only_https_is_asked(url):
    with pytest.raises(InputError):
        check_url(url)


def test_the_internet_leads_not_back_to_this_machine():
    check_url("http://localhost:1/a", "http://127.0.0.1:1/b")
    with pytest.raises(InputError):
        check_url("http://localhost:1/a", "https://example.org/b")


def tar_of(*members):
    out = io.BytesIO()
    with tarfile.open(fileobj=out, mode="w:gz") as tar:
        for name, content in members:
            info = tarfile.TarInfo(name)
            if isinstance(content, bytes):
                info.size = len(content)
                tar.addfile(info, io.BytesIO(content))
            else:
                info.type, info.linkname = content.encode(), "/etc/passwd"
                tar.addfile(info)
    return out.getvalue()


def zip_of(*members):
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in members:
            info = zipfile.ZipInfo(name)
            if not isinstance(content, bytes):
                info.external_attr = (stat.S_IFLNK | 0o777) << 16
            archive.writestr(info, content if isinstance(content, bytes) else b"/etc/passwd", zipfile.ZIP_DEFLATED)
    return out.getvalue()


ESCAPES = [f"{NAME}/../../evil", "/tmp/evil", "../evil", f"{NAME}\\..\\evil", "C:evil", f"{NAME}/e\x1bvil"]
LINKS = ["1", "2", "3", "6"]  # hard, symbolic, character device, pipe


def unpacks(tmp_path, suffix, data):
    room = tmp_path / "in" / "here"
    room.mkdir(parents=True)
    archive = tmp_path / f"{NAME}{suffix}"
    archive.write_bytes(data)
    try:
        return unpack(archive, room / NAME)
    finally:
        assert names(tmp_path) == sorted([archive.name, "in"])  # nothing was written elsewhere
        assert names(tmp_path / "in") == ["here"]
        assert set(names(room)) <= {NAME}


@pytest.mark.parametrize("make", [tar_of, zip_of])
@pytest.mark.parametrize("name", ESCAPES)
def test_nothing_is_written_elsewhere(tmp_path, make, name):
    with pytest.raises(InputError, match="would be written elsewhere"):
        unpacks(tmp_path, ".tgz" if make is tar_of else ".zip", make((f"{NAME}/a", b"1"), (name, b"evil")))


@pytest.mark.parametrize(("make", "kind"), [*((tar_of, kind) for kind in LINKS), (zip_of, None)])
def test_links_and_devices_are_refused(tmp_path, make, kind):
    with pytest.raises(InputError, match="is a link or device; only files and folders"):
        unpacks(tmp_path, ".tgz" if make is tar_of else ".zip", make((f"{NAME}/a", b"1"), (f"{NAME}/b", kind)))


@pytest.mark.parametrize("make", [tar_of, zip_of])
def test_a_bomb_is_not_unpacked(tmp_path, make):
    suffix = ".tgz" if make is tar_of else ".zip"
    with pytest.raises(InputError, match="would be more than 2 MB"):
        unpacks(tmp_path, suffix, make((f"{NAME}/a", b"1"), (f"{NAME}/zeros", bytes(30_000_000))))
    assert sum(p.stat().st_size for p in (tmp_path / "in").rglob("*") if p.is_file()) <= 1


def test_a_bomb_of_what_is_skipped_or_a_header_is_not_read(tmp_path, monkeypatch):
    monkeypatch.setattr(archives, "MEMBERS", 100)
    with pytest.raises(InputError, match="goes on after"):
        unpacks(tmp_path / "a", ".tgz", tar_of(("other", bytes(30_000_000)), (f"{NAME}/a", b"1")))
    info = tarfile.TarInfo("x")
    info.type, info.size = tarfile.XHDTYPE, 30_000_000
    bomb = gzip.compress(info.tobuf() + bytes(info.size))
    with pytest.raises(InputError, match="a header of 3"):
        unpacks(tmp_path / "b", ".tgz", bomb)
    with pytest.raises(InputError, match="more than 100 members"):
        unpacks(tmp_path / "c", ".zip", zip_of(*((f"{NAME}/{k}", b"") for k in range(101))))


def test_broken_archives_are_told(tmp_path, packed):
    tar = gzip.decompress(packed[".tgz"])
    broken = {
        "cut.tgz": packed[".tgz"][:-100],
        "sum.tgz": packed[".tgz"][:-8] + bytes(4) + packed[".tgz"][-4:],
        "header.tgz": gzip.compress(tar[:1024] + b"\xff" * 512 + tar[1536:]),
        "cut.zip": packed[".zip"][:-100],
        "text.zip": b"hello",
        "flip.zip": packed[".zip"].replace(b"IDAT", b"IDAX", 1),
    }
    for name, data in broken.items():
        room = tmp_path / name.replace(".", "_")
        room.mkdir()
        with pytest.raises(InputError, match=r"is broken|ends early"):
            unpacks(room, name[name.index(".") :], data)


def test_other_contents_are_counted_and_doubles_refused(tmp_path):
    assert unpacks(tmp_path / "a", ".zip", zip_of(("__MACOSX/._a", b"x"), (f"./{NAME}/a/b", b"1"))) == 1
    assert (tmp_path / f"a/in/here/{NAME}/a/b").read_bytes() == b"1"
    with pytest.raises(InputError, match=f"holds no folder {NAME}"):
        unpacks(tmp_path / "b", ".tgz", tar_of(("other/a", b"1")))
    with pytest.raises(InputError, match="twice"):
        unpacks(tmp_path / "c", ".tgz", tar_of((f"{NAME}/a", b"1"), (f"{NAME}/a", b"2")))


def test_the_catalogue_says_what_a_user_must_know():
    offers = datasets_on_offer()
    assert len({offer.name for offer in offers}) == len(offers) == 39
    for offer in offers:
        check_url(offer.url)
        assert offer.url.endswith(offer.file)
        assert offer.licence
        assert offer.cite
        assert offer.about
        assert offer.file.startswith(offer.folder)
        assert re.fullmatch(r"([0-9a-f]{64})?", offer.sha256)
        assert offer.size or not offer.sha256
    assert sum(bool(offer.movers) for offer in offers) == 33
    walking = named("rgbd_dataset_freiburg3_walking_xyz", offers)
    assert walking.url == "https://cvg.cit.tum.de/rgbd/dataset/freiburg3/rgbd_dataset_freiburg3_walking_xyz.tgz"
    crowd = named("bonn_crowd", offers)
    assert crowd.url == "https://www.ipb.uni-bonn.de/html/projects/rgbd_dynamic2019/rgbd_bonn_crowd.zip"
    with pytest.raises(InputError, match="nearest is freiburg3_walking_xyz"):
        named("freiburg3_waking_xyz", offers)


def test_the_list_asks_nobody_and_says_what_is_there(tmp_path):
    write_tum_folder(tmp_path / "rgbd_dataset_freiburg1_xyz")
    (tmp_path / "rgbd_bonn_crowd.zip.partial").write_bytes(bytes(2_000_000))
    done = command("datasets", "list", cwd=tmp_path, before=no_network)
    assert done.returncode == 0, done.stderr
    lines = {line.split()[0]: line for line in done.stdout.splitlines()}
    assert lines["freiburg1_xyz"].endswith("[here]")
    assert lines["bonn_crowd"].endswith("[begun: 2 MB]")
    assert "licence: CC BY 4.0" in done.stdout
    told = json.loads(command("datasets", "list", "--json", cwd=tmp_path, before=no_network).stdout)
    assert [x["name"] for x in told if x["state"]] == ["freiburg1_xyz", "bonn_crowd"]


def test_the_command_shows_the_licence_and_says_whom_it_trusted(site, tmp_path, packed):
    folder = "rgbd_dataset_freiburg1_rpy"
    made = write_tum_folder(tmp_path / "made" / folder, camera=CAMERA)
    out = io.BytesIO()
    with tarfile.open(fileobj=out, mode="w:gz") as tar:
        tar.add(made, folder)
    site.files["/mirror.tgz"] = Served(out.getvalue())
    asked = ("datasets", "get", "freiburg1_rpy", "--url", f"{site.url}/mirror.tgz")
    done = command(*asked, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "licence: CC BY 4.0" in done.stderr
    assert "please cite: J. Sturm" in done.stderr
    assert "nobody publishes one, so this download was trusted" in done.stdout
    assert command("info", folder, cwd=tmp_path).returncode == 0
    again = command(*asked, cwd=tmp_path)
    assert (again.returncode, again.stderr.splitlines()[-1]) == (
        2,
        f"vlmm-log: {folder}: exists; give --force to replace it",
    )
    told = command(*asked, "--force", "--json", cwd=tmp_path)
    assert json.loads(told.stdout)["sha256_by"] == "the first download"
    gone = command(*asked[:-1], f"{site.url}/gone", "--force", cwd=tmp_path)
    assert gone.returncode == 2
    assert "licence" in gone.stderr.splitlines()[1]  # also before a download that fails
    assert "status 404" in gone.stderr.splitlines()[-1]
