"""Tables on the stand-ins of `sim`, which share no code with the upload."""

import re
from pathlib import Path

import pytest
from memory_net import meet, standin

from coaxlink.mavlink.ftp import FileError, Files
from coaxlink.mavlink.parameters import Parameters
from coaxlink.uploading.ardupilot_scripts import ScriptFolder
from coaxlink.uploading.backup import read_backup
from coaxlink.uploading.content import Content
from coaxlink.uploading.journal import Entry, Journal
from coaxlink.uploading.outcome import Talk
from coaxlink.uploading.plan import load_plan
from coaxlink.uploading.verify import verify
from coaxlink.uploading.worker import Uploader
from firmware_params.ardupilot import packed, scripts

pytestmark = pytest.mark.slow


def test_what_is_verified_survives_a_power_cut_and_a_reboot(tables, tmp_path):
    """PX4 saves its parameters up to two seconds late: the word "verified" must not come before."""
    plan, memory, reported = load_plan(tables["px4"]), tmp_path / "flash", []
    with standin("px4", memory=memory) as board, meet(board) as session:
        assert Uploader(session, backup_folder=tmp_path).upload(plan).result == "verified"
    with standin("px4", memory=memory) as board, meet(board) as session:
        assert verify(session, plan).holds
        worker = Uploader(session, backup_folder=tmp_path, talk=Talk(say=reported.append), reboot_s=0.4)
        assert worker.upload(plan, reboot=True).result == "verified" and "rebooting" in reported


def _ap(session, folder, **options):
    return Uploader(session, backup_folder=folder, reboot_s=0.4, script_s=6.0, **options)


# what an ArduCopter changes by itself over a restart or a while
OWN = {"BARO1_GND_PRESS", "COMPASS_DEC", "INS_GYROFFS_X", "INS_GYROFFS_Y", "INS_GYROFFS_Z"}


def _of_the_user(session):
    values = Parameters(session).read_all().values
    return {n: v.value for n, v in values.items() if n not in OWN and not n.startswith("STAT_")}


def _comes(session, reported, text, wait_s=10.0):
    end = session.clock.monotonic() + wait_s
    while not any(text in line for line in reported):
        assert session.clock.monotonic() < end, reported
        session.clock.sleep(0.05)


def _ardupilot_said(session):
    reported = []
    session.subscribe(lambda m: reported.append(m.text) if m.get_type() == "STATUSTEXT" else None)
    return reported


def test_ardupilot_takes_a_matrix_and_then_a_loader_whose_tables_are_live(tables, tmp_path):
    with standin("ardupilot") as board, meet(board) as session:
        reported = _ardupilot_said(session)
        before = _of_the_user(session)

        def upload(name):
            talk = []
            worker = _ap(session, tmp_path / "b", talk=Talk(say=talk.append))
            outcome = worker.upload(load_plan(tables[name]))
            assert outcome.result == "verified", outcome.reason
            return outcome, talk

        first, talk = upload("matrix")
        assert "rebooting" in talk and first.scripts == (f"/APM/scripts/{scripts.MATRIX_NAME}",)
        _comes(session, reported, "matrix of 8 motors")
        assert Parameters(session).read("FRAME_CLASS").value == 15

        _, talk = upload("loader")
        assert "rebooting" in talk and Files(session).crc(f"/APM/scripts/{scripts.MATRIX_NAME}") is None
        reported.clear()
        third, talk = upload("loader-standard")
        assert "rebooting" not in talk
        _comes(session, reported, "table of 8 motors live")  # no reboot, no second init
        assert verify(session, None).holds and verify(session, load_plan(tables["loader-standard"])).holds
        other = verify(session, load_plan(tables["loader"]))
        assert {w["name"] for w in other.mismatches} >= {"CXL_SUM", "CXL_T1"}
        backed_up = verify(session, load_plan(Path(third.backup)))  # has the loader's table before it
        assert {w["name"] for w in backed_up.mismatches} == {w["name"] for w in other.mismatches}
        Files(session).write(f"/APM/scripts/{scripts.LOADER_NAME}", b"-- altered")
        assert [w["name"] for w in verify(session, None).mismatches] == [
            f"/APM/scripts/{scripts.LOADER_NAME}"
        ]

        back = _ap(session, tmp_path / "b").restore(read_backup(Path(first.backup)))
        assert back.result == "verified", back.reason
        assert _of_the_user(session) == before
        assert Files(session).listing("/APM/scripts") == []


def test_ardupilot_refuses_what_it_must(tables, tmp_path):
    with standin("ardupilot") as board, meet(board) as session:
        folder = tmp_path / "t"
        (folder / "scripts").mkdir(parents=True)
        text = without_sums(next(tables["matrix"].glob("*.param")).read_text())
        (folder / "scripts" / "a.lua").write_text("-- a")

        def upload(change):
            (folder / "x.param").write_text(re.sub(*change, text))
            return _ap(session, tmp_path / "b").upload(load_plan(folder))

        for change, why in (
            ((r"MOT_THST_EXPO,[\d.]+\n", "MOT_THST_EXPO,5\n"), "MOT_THST_EXPO = 5 is outside"),
            ((r"FRAME_CLASS,15", "FRAME_CLASS,15.5"), "would be kept as 15"),
            ((r"MOT_SPIN_MIN,0.05", "MOT_SPIN_MIN,nan"), "MOT_SPIN_MIN is nan"),
            ((r"SERVO[78]_FUNCTION,\d+\n", ""), "for 6 rotors, the board drives 8"),
            ((r"SCR_ENABLE", "SCR_ENABLED"), "has no parameter SCR_ENABLED"),
        ):
            outcome = upload(change)
            assert outcome.result == "refused" and why in outcome.reason and outcome.error.exit_code == 4
        path = folder / "scripts" / scripts.MATRIX_NAME
        path.write_text(turned(next((tables["matrix"] / "scripts").iterdir()).read_text()))
        outcome = upload(("FRAME_CLASS,15", "FRAME_CLASS,15"))
        assert outcome.result == "refused" and "rotor 1 changes spin (8 rotors differ)" in outcome.reason
        outcome = Uploader(session, backup_folder=tmp_path).upload(load_plan(tables["px4"]))
        assert outcome.result == "refused" and "is for PX4, the vehicle runs ArduPilot" in outcome.reason
        assert not (tmp_path / "b").exists()


def without_sums(text):
    """As an owner writes it: by its checksums a half of another table is refused unasked."""
    return re.sub(r"^(# File: |SCR_LD_CHECKSUM,).*\n", "", text, flags=re.MULTILINE)


def turned(script):
    """Our matrix script with every yaw factor turned round."""
    factors = [(r, p, -y, t) for r, p, y, t in scripts.script_factors(script)]
    return scripts.matrix_script(factors, title="turned")


def test_a_script_that_fails_its_own_check_is_rolled_back_or_cannot_arm(tables, tmp_path):
    """A table that asks for a loader whose checksum parameter never appears goes back whole."""
    folder = tmp_path / "t"
    (folder / "scripts").mkdir(parents=True)
    (folder / "x.param").write_text(without_sums(next(tables["loader"].glob("*.param")).read_text()))
    (folder / "scripts" / scripts.LOADER_NAME).write_text("error('broken')\n")
    with standin("ardupilot") as board, meet(board) as session:
        before = _of_the_user(session)
        outcome = _ap(session, tmp_path / "b").upload(load_plan(folder))
        assert outcome.result == "rolled_back" and "CXL_SUM does not appear" in outcome.reason
        assert _of_the_user(session) == before
        assert Files(session).listing("/APM/scripts") == []


def test_a_file_that_an_old_request_spoils_is_written_again(monkeypatch):
    """A doubled and delayed "remove" comes after the renaming; a restart forgets an open file."""
    with standin("ardupilot") as board, meet(board) as session:
        files, other, late = Files(session), Files(session), ["rename", "write"]
        request, window = files._request, files._window

        def spoil(code, data, **kw):
            answer = request(code, data, **kw)
            if code == 13 and "rename" in late:
                late.remove("rename")
                other.remove("/APM/a.lua")
            return answer

        def forget(what, orders):
            if "write" in late and any(order.code == 7 for order in orders.values()):
                late.remove("write")
                other._request(1, b"")  # the board has one session, and it is closed now
            return window(what, orders)

        monkeypatch.setattr(files, "_request", spoil)
        monkeypatch.setattr(files, "_window", forget)
        files.write("/APM/a.lua", b"-- whole")
        assert other.read("/APM/a.lua") == b"-- whole" and late == []
        assert other.listing("/APM") == ["a.lua"]


def test_a_folder_without_a_parent_is_no_end_of_the_search(monkeypatch):
    """The real SITL has no /APM: making /APM/scripts there is answered with errno 2."""
    with standin("ardupilot") as board, meet(board) as session:
        files, made = Files(session), []
        request = files._request

        def without_apm(code, data, **kw):
            if data.startswith(b"/APM"):
                raise FileError("/APM/scripts", 10)
            made.append((code, data))
            return request(code, data, **kw)

        monkeypatch.setattr(files, "_request", without_apm)
        assert ScriptFolder(files).path == "scripts" and made


def test_the_packed_file_is_the_list():
    with standin("ardupilot") as board, meet(board) as session:
        found = packed.unpack(Files(session).read(packed.PATH))
        listed = Parameters(session).read_all().values
        assert found == {n: (v.value, v.type) for n, v in listed.items()}


def test_an_interrupted_change_of_scripts_does_not_bring_the_other_script_back(tables, tmp_path):
    """Killed when the loader was gone and the matrix there, before the restart that makes it fly."""
    with standin("ardupilot") as board, meet(board) as session:
        matrix, loader = (f"/APM/scripts/{n}" for n in (scripts.MATRIX_NAME, scripts.LOADER_NAME))
        plan = load_plan(tables["matrix"])
        assert _ap(session, tmp_path / "b").upload(plan).result == "verified"
        old = Content({}, {matrix: None, loader: b"-- the loader that was there"})
        new = Content({}, {matrix: plan.scripts[scripts.MATRIX_NAME], loader: None})
        journal = Journal(session.identity, address=session.address)
        journal.begin(Entry(journal.board, old, new, "backup", (), "yesterday"))
        talk = []
        again = _ap(session, tmp_path / "b", talk=Talk(say=talk.append)).upload(plan)
        assert again.result == "verified" and "rebooting" in talk
        assert Files(session).listing("/APM/scripts") == [scripts.MATRIX_NAME]
        assert journal.open_entry() is None and verify(session, plan).holds
