"""The file of a frozen split, checked at the edge: tracks of adversaries, and what they are put into.

Nothing of the recordings is in it but names, instance identifiers and each adversary's recorded pose at its launch
(docs/frozen-splits.md).
"""

from pathlib import Path
from typing import Annotated, Any, Final, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, SerializerFunctionWrapHandler, model_serializer, model_validator

from benchmark.errors import InputError
from benchmark.machine.storage import canonical_json, content_key, read_json, write_bytes
from benchmark.records.review import LONGEST_REASON
from benchmark.records.seed_splits import DRIVEN_EGOS, is_adversarial
from benchmark.records.store import validate_stored

FORMAT: Final = "challenger-bench frozen split"
SCHEMA, DRIVEN_SCHEMA = 1, 2
"""The second one has tracks of an ego that was driven, and of those who answered it."""
EDITED: Final = "edited"
"""Replaces the version of the search if the scenes were edited by hand and not verified."""
MOST_BYTES: Final = 256 * 1024 * 1024
"""No frozen split of any data set is larger; a file that is will not be read into memory."""
METRE_DIGITS: Final = 3
YAW_DIGITS: Final = 5
"""With a millimetre for the centre, corners of bodies up to 50 m long stay within a millimetre."""

_Metres = Annotated[float, Field(ge=-1e8, le=1e8)]
_Radians = Annotated[float, Field(ge=-1e3, le=1e3)]
_Hash = Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]
_Name = Annotated[str, Field(min_length=1, max_length=200)]
_Plain = Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9._+-]*$", max_length=200)]
Pose = tuple[_Metres, _Metres, _Radians]
"""x, y and yaw of a box centre in the global frame."""


class _FrozenModel(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False, strict=True)


class FrozenAdversary(_FrozenModel):
    """One adversary: from ``launch_frame`` (12 Hz), where it was ``recorded``, it follows the track to the end.

    Attributes:
        instance: Instance of the recording.
        track: x, y, yaw of the box centre at 12 Hz.
    """

    instance: _Name
    launch_frame: Annotated[int, Field(ge=0, le=1_000_000)]
    recorded: Pose
    track: Annotated[tuple[Pose, ...], Field(min_length=1, max_length=1_000_000)]


class FrozenTrack(_FrozenModel):
    """Where one who answered the ego drove; it is gone after the last pose.

    Attributes:
        instance: Instance of the recording.
        first_frame: Its first frame (12 Hz).
        track: x, y, yaw of the box centre from then on.
    """

    instance: _Name
    first_frame: Annotated[int, Field(ge=0, le=1_000_000)]
    track: Annotated[tuple[Pose, ...], Field(min_length=1, max_length=1_000_000)]


class FrozenDrive(_FrozenModel):
    """An ego that was driven, and ``others`` who answered it.

    Attributes:
        ego: x, y, yaw of its rear axle at every frame (12 Hz).
    """

    ego: Annotated[tuple[Pose, ...], Field(min_length=1, max_length=1_000_000)]
    others: tuple[FrozenTrack, ...] = ()


class FrozenScene(_FrozenModel):
    """One scene, with its adversaries in the order in which they were planned.

    ``tables`` is a hash with numbers rounded to a nanometre (`generation.splits.tracks`), ``images`` one of key frames.
    Older splits have neither ``numbered`` nor ``shift_us``: their tables have the scene's name and recorded times.

    Attributes:
        name: Of the new scene.
        numbered: Its name in the tables.
        shift_us: By how much its times there are later than recorded.
        source: Recorded scene.
        adversaries: Their tracks.
        driven: Tracks of an ego that was driven; ``None`` for the recorded one.
    """

    name: _Plain
    source: _Name
    adversaries: Annotated[tuple[FrozenAdversary, ...], Field(min_length=1)]
    tables: _Hash
    images: _Hash | None = None
    numbered: _Plain | None = None
    shift_us: Annotated[int, Field(ge=0, le=10**16)] | None = None
    driven: FrozenDrive | None = None

    @model_serializer(mode="wrap")
    def _omit_later_fields(self, plain: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """Older splits keep their bytes and their content hash."""
        values: dict[str, Any] = plain(self)
        return {name: value for name, value in values.items() if value is not None or name == "images"}

    @model_validator(mode="after")
    def _check_consistency(self) -> Self:
        if not self.name.startswith(self.source.replace("/", "-")):
            raise ValueError(f"the scene {self.name} is not named after its recorded scene {self.source}")
        instances = [adversary.instance for adversary in self.adversaries]
        if len(set(instances)) < len(instances):
            raise ValueError(f"{self.name} names the same adversary twice")
        return self

    @property
    def identity(self) -> str:
        """Hash of what the scene is: its tokens are made of it, so that they are the same on every machine."""
        driven = [] if self.driven is None else [self.driven.model_dump(mode="json")]
        return content_key(self.source, [each.model_dump(mode="json") for each in self.adversaries], *driven)


class RecordingsIdentity(_FrozenModel):
    """The data set that a split was frozen from: its name, and its content hash there.

    Attributes:
        name: Of the data set.
        fingerprint: Hash of its content.
    """

    name: str
    fingerprint: str


class SearchMetadata(_FrozenModel):
    """Hashes that identify a search, and its seed.

    ``solvable`` says whether scenes that no driver could have avoided were dropped; none were in files without.

    Attributes:
        algorithm: Version of the search.
        hyper: Hash of its settings.
        prior: Hash of the trajectory model.
        seed: Of the search.
        ego: Reference driver in the place of the recorded ego, if there was one.
    """

    algorithm: str
    hyper: str
    prior: str
    seed: int
    solvable: bool | None = None
    ego: Annotated[str, Field(pattern=f"^({'|'.join(DRIVEN_EGOS)})$")] | None = None

    @model_serializer(mode="wrap")
    def _omit_later_fields(self, plain: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """Leave out fields that older files do not have, so that their content hash stays."""
        values: dict[str, Any] = plain(self)
        return {name: value for name, value in values.items() if value is not None}


class FrozenRejection(_FrozenModel):
    """A scene that an inspector rejected before the split was frozen: its name, its token there, and why.

    Attributes:
        name: Of the scene.
        token: Of the scene.
        reason: The inspector's.
    """

    name: _Name
    token: _Name
    reason: Annotated[str, Field(max_length=LONGEST_REASON)]


class SceneChoice(_FrozenModel):
    """Choice of the scenes: numbers tried and kept, and limits, of which null keeps all.

    ``surrogate`` fails every scene, if one was asked. Files without inspectors' rejections, ``variants`` that were to
    differ, ``asked`` manoeuvres or a ``panel`` that ranked have no such fields.

    Attributes:
        scenes: Recorded scenes that were searched.
        tried: Vehicles that were tried.
        survived: Attempts that passed verification.
        per_scene: Most scenes of one recording.
        total: Most scenes of all.
        rejected: Scenes that inspectors rejected.
    """

    scenes: int
    tried: int
    survived: int
    per_scene: int | None
    total: int | None
    surrogate: str | None
    rejected: tuple[FrozenRejection, ...] | None = None
    variants: Annotated[int, Field(ge=1)] | None = None
    asked: tuple[_Name, ...] | None = None
    panel: Annotated[str, Field(max_length=LONGEST_REASON)] | None = None

    @model_serializer(mode="wrap")
    def _omit_empty_fields(self, plain: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """Splits without the younger fields keep the bytes, and the content hash, that they had before these came."""
        values: dict[str, Any] = plain(self)
        younger = ("rejected", "variants", "asked", "panel")
        return {name: value for name, value in values.items() if value or name not in younger}


class ImageMetadata(_FrozenModel):
    """Which images the hashes of images are of: renderer, its version, size in pixels and JPEG quality.

    Attributes:
        renderer: Its name.
        version: Of the renderer.
        width: Pixels.
        height: Pixels.
        jpeg_quality: Of the files.
    """

    renderer: str
    version: str
    width: int
    height: int
    jpeg_quality: int


class FrozenSplit(_FrozenModel):
    """A frozen split, its scenes most challenging first; ``images`` is null if no scene has an image hash.

    Attributes:
        format: Marks the file.
        schema_version: Version of the format.
        split: Always ``adv``.
        recordings: Data set that it was made from.
        search: Which search.
        chosen: How scenes were chosen.
        scenes: Scenes and tracks.
    """

    format: Literal["challenger-bench frozen split"] = FORMAT
    schema_version: Annotated[int, Field(alias="schema", ge=SCHEMA, le=DRIVEN_SCHEMA)] = SCHEMA
    split: Literal["adv"] = "adv"
    recordings: RecordingsIdentity
    search: SearchMetadata
    chosen: SceneChoice
    images: ImageMetadata | None
    scenes: Annotated[tuple[FrozenScene, ...], Field(min_length=1)]

    @model_validator(mode="after")
    def _check_ego(self) -> Self:
        driven = self.search.ego is not None
        if driven != (self.schema_version == DRIVEN_SCHEMA) or any(
            driven != (scene.driven is not None) for scene in self.scenes
        ):
            raise ValueError("a split with a driven ego has format 2 and its tracks in every scene, no other has")
        return self

    @model_validator(mode="after")
    def _check_distinct(self) -> Self:
        known: set[str] = set()
        for scene in self.scenes:
            for name in dict.fromkeys((scene.name, scene.numbered or scene.name)):
                if name in known:
                    raise ValueError(f"two scenes have the name {name}")
                known.add(name)
        return self

    @property
    def content_id(self) -> str:
        """Hash of all that it says."""
        return content_key(self.model_dump(mode="json", by_alias=True))

    def text(self) -> str:
        """The file: a line for each scene, the same for the same content."""
        content = self.model_dump(mode="json", by_alias=True)
        scenes = ",\n".join(map(canonical_json, content.pop("scenes")))
        head = canonical_json(content, indent=1).removesuffix("\n}")
        return f'{head},\n "scenes": [\n{scenes}\n ]\n}}\n'


def read_frozen(path: Path) -> FrozenSplit:
    """Read a frozen split; whether it fits the recordings at hand is seen when it is built."""
    try:
        size, data = path.stat().st_size, b""
        if size <= MOST_BYTES:
            data = path.read_bytes()
    except OSError as error:
        raise InputError(f"cannot read the frozen split {path}: {error.strerror or error}") from error
    if size > MOST_BYTES:
        raise InputError(f"{path} has {size} bytes, too many for a frozen split; name another file")
    stored = read_json(path)
    if not isinstance(stored, dict) or stored.get("format") != FORMAT:
        raise InputError(f"{path} is not a frozen split: it lacks the format {FORMAT!r}; generate --freeze writes one")
    if type(stored.get("schema")) is not int or stored["schema"] not in (SCHEMA, DRIVEN_SCHEMA):
        raise InputError(
            f"{path} has version {stored.get('schema')!r} of the format, but this version reads {SCHEMA} and "
            f"{DRIVEN_SCHEMA}; upgrade challenger-bench or fetch the file again"
        )
    return validate_stored(
        FrozenSplit.model_validate_json,
        data,
        lambda where, why: f"{path} is not a valid frozen split: {f'{where}: ' if where else ''}{why}; fetch it again",
    )


def require_freezable(split: str, path: Path) -> None:
    """Refuse, before a long search, what could not be frozen after it: no search, no folder, or a taken name."""
    if not is_adversarial(split):
        raise InputError(f"only adv can be frozen, because {split} involves no search; leave --freeze out")
    if path.exists() and not path.is_file():
        raise InputError(f"--freeze {path} is a folder, a pipe or a device; name a file")
    if path.is_file():
        read_frozen(path)
    elif not path.parent.is_dir():
        raise InputError(f"there is no folder {path.parent} for the frozen split; make it or name another file")


def write_frozen(path: Path, frozen: FrozenSplit) -> None:
    """Write a frozen split; one that is there is never replaced by another."""
    if path.exists() and read_frozen(path) != frozen:
        raise InputError(f"{path} holds another frozen split, which may already be in use; give this one another name")
    write_bytes(path, frozen.text().encode())
