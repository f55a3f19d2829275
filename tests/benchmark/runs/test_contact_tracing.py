"""Contacts of records again with their tracks, and the pictures of them."""

from pathlib import Path

import cv2
import pytest

from benchmark.closed_loop.engines import make_backend
from benchmark.errors import InputError
from benchmark.evaluation import EvalSettings, evaluate
from benchmark.fairness.contact_fault import judge_contact, load_roads
from benchmark.report.contact_pictures import write_contact_picture
from benchmark.runs.contact_tracing import open_with_data, trace_worst_contacts
from benchmark.runs.driving import DriveSettings, drive_split
from tests.benchmark.closed_loop.staged import Watching
from tests.benchmark.fake_data import FakeData, town_of_two
from tests.benchmark.planners import Straight
from tests.hand_made import Car, scene_on_straight_road

DATA = town_of_two(slow_leader=True)


def test_pictures_say_what_the_records_say(tmp_path: Path) -> None:
    ran = evaluate(DATA, "val", Straight(), tmp_path / "runs", EvalSettings(protocols=("exact",)))
    record, opened = open_with_data(ran.directory, lambda _: DATA)
    (traced,) = trace_worst_contacts(record, opened)
    row = next(row for row in ran.rows if (row.scene, row.index) == (traced.scene.name, traced.index))
    assert row.severity is not None and row.severity.contact is not None and row.severity.contact.fault is not None
    fault, stored = judge_contact(traced.scene, traced.tracks), row.severity.contact.fault
    assert (fault.verdict, fault.reason) == (stored.verdict, stored.reason) == ("ego", "rear-end")
    drawn = tmp_path / "contact.png"
    write_contact_picture(drawn, traced.tracks, load_roads(traced.scene), fault, "a title")
    picture = cv2.imread(str(drawn))
    # Both colours and the grey road are there.
    for blue, green, red in ((55, 127, 26), (12, 89, 232), (236, 236, 236)):
        assert (abs(picture.astype(int) - (blue, green, red)).max(axis=2) <= 8).sum() > 200
    assert not list(trace_worst_contacts(record, opened, ["scene-9902-not"]))


def test_drives_are_driven_again_to_their_contacts(tmp_path: Path) -> None:
    scene = scene_on_straight_road((Car(20.0, 198.25, 12.0), Car(110.0, 198.25, 0.0)), ego_speed=8.0, seconds=16.0)
    data = FakeData({scene.name: scene})
    for until, verdict in (("contact", "other"), ("fault", "ego")):
        settings = DriveSettings("default", make_backend("default", until=until))
        made = drive_split(data, "val", Watching(speed=6.0), tmp_path / until, settings)
        record, opened = open_with_data(made.directory, lambda _: data)
        (traced,) = trace_worst_contacts(record, opened)
        (row,) = made.rows
        told = (row.contact or row.passed[0]).fault
        found = judge_contact(traced.scene, traced.tracks)
        assert told is not None and (told.verdict, told.reason) == (found.verdict, found.reason)
        assert found.verdict == verdict


def test_a_folder_without_a_record_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError):
        open_with_data(tmp_path, lambda _: DATA)
