"""Inspectors' verdicts on scenes: the file beside a split, and which of its verdicts are still valid.

The paper inspects scenes by hand (appendix "The Adv-nuSc Dataset"). ``review.json`` in the root of a data set holds the
verdicts. A verdict is about a scene as it was when it was looked at: it names the token of its row, which for generated
scenes is made of their motion. On another scene of the same name it does not stand.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Final, Literal, Self

from pydantic import AfterValidator, Field, model_validator

from benchmark.errors import InputError
from benchmark.machine.storage import content_key
from benchmark.records.run_schema import ReviewFacts
from benchmark.records.store import validate_stored
from benchmark.records.stored import Stored
from benchmark.report.words import pluralise
from benchmark.untrusted.files import VERDICTS
from benchmark.untrusted.text_files import read_json

REVIEW_FILE: Final = "review.json"
FORMAT: Final = "challenger-bench review"
SCHEMA: Final = 1
ACCEPTED: Final = "accepted"
REJECTED: Final = "rejected"
LONGEST_REASON: Final = 500
"""Characters."""


def _one_line(text: str) -> str:
    if not text.isprintable():
        raise ValueError("must be one line of printable text")
    return text


Decision = Literal["accepted", "rejected"]
OneLineText = Annotated[str, Field(max_length=LONGEST_REASON), AfterValidator(_one_line)]


class Verdict(Stored):
    """An inspector's verdict on one scene.

    Attributes:
        verdict: Whether it may be judged.
        reason: Why; a rejection has one.
        inspector: Who says so, if they want to be named.
        token: Of the scene's row when it was looked at.
    """

    verdict: Decision
    reason: OneLineText = ""
    inspector: OneLineText = ""
    token: Annotated[str, Field(min_length=1, max_length=200), AfterValidator(_one_line)]

    @model_validator(mode="after")
    def _rejected_for_something(self) -> Self:
        if self.verdict == REJECTED and not self.reason.strip():
            raise ValueError("a rejected scene needs a reason")
        return self


class ReviewFile(Stored):
    """``review.json``: verdicts by name of the scene, as the opened data set calls it.

    Attributes:
        format: Marks the file.
        schema_version: Version of the format.
        verdicts: By name of the scene.
    """

    format: Literal["challenger-bench review"] = FORMAT
    schema_version: int = Field(alias="schema")
    verdicts: dict[str, Verdict]


@dataclass(frozen=True, slots=True, order=True)
class StandingVerdict:
    """A verdict that stands, on the scene whose row has the token.

    ``left_out`` is whether a build did not write the scene for it, so that it is not there.
    """

    name: str
    token: str
    verdict: Decision
    reason: str = ""
    left_out: bool = False


@dataclass(frozen=True, slots=True)
class SplitReview:
    """Verdicts of inspectors on the scenes of a split, by name, those on scenes that a build left out included.

    ``waiting`` scenes have no verdict, ``outdated`` ones a verdict on another scene of the same name.
    """

    judged: tuple[StandingVerdict, ...] = ()
    waiting: tuple[str, ...] = ()
    outdated: tuple[str, ...] = ()

    @property
    def rejected(self) -> dict[str, str]:
        """Reasons by name of the scenes that were rejected."""
        return {verdict.name: verdict.reason for verdict in self.judged if verdict.verdict == REJECTED}

    @property
    def present(self) -> tuple[str, ...]:
        """Every scene that is there to be looked at, with any verdict or none."""
        return tuple(sorted({*(verdict.name for verdict in self.judged if not verdict.left_out), *self.waiting}))

    @property
    def facts(self) -> ReviewFacts | None:
        """Facts of the review for records; ``None`` where no verdict stands."""
        if not self.judged:
            return None
        rejected = len(self.rejected)
        return ReviewFacts(
            content=content_key(
                "review", sorted([verdict.name, verdict.token, verdict.verdict] for verdict in self.judged)
            ),
            accepted=len(self.judged) - rejected,
            rejected=rejected,
            not_reviewed=len(self.waiting),
        )

    @property
    def named(self) -> tuple[str, ...]:
        """Every scene that it is about."""
        return (*(verdict.name for verdict in self.judged), *self.waiting)

    def sentence(self) -> str:
        """The review in words, without the split's name."""
        outdated = f"; {pluralise(len(self.outdated), 'older verdict')} on other content" if self.outdated else ""
        return f"{describe_review(self.facts)}{outdated}"

    def kept(self, names: Sequence[str]) -> tuple[str, ...]:
        """Those of some scenes that are not rejected."""
        rejected = self.rejected
        return tuple(name for name in names if name not in rejected)

    def under(self, folder: str) -> "SplitReview":
        """The same of a root that lies beside others: its scenes are called after its folder, too."""
        judged = tuple(replace(verdict, name=f"{folder}/{verdict.name}") for verdict in self.judged)
        outdated = tuple(f"{folder}/{name}" for name in self.outdated)
        return SplitReview(judged, tuple(f"{folder}/{name}" for name in self.waiting), outdated)


NOT_REVIEWED: Final = "not reviewed"


def describe_review(facts: ReviewFacts | None) -> str:
    """Verdicts of inspectors in words: ``not reviewed``, or how many scenes they rejected and accepted."""
    if facts is None:
        return NOT_REVIEWED
    return (
        f"{pluralise(facts.rejected, 'scene')} rejected by hand, {facts.accepted} accepted, "
        f"{facts.not_reviewed} {NOT_REVIEWED} (review {facts.content[:12]})"
    )


def require_not_rejected(names: Sequence[str], rejected: Mapping[str, str], where: str) -> None:
    """Refuse scenes that were asked for by name and that an inspector rejected, with the reasons in ``rejected``."""
    for name in names:
        if name in rejected:
            raise InputError(
                f"scene {name} was rejected by hand ({rejected[name]}); rejected scenes are not evaluated: leave it "
                f"out, or take the verdict back with: challenger-bench data review {where}"
            )


def read_review(root: Path) -> dict[str, Verdict]:
    """Verdicts that lie beside a data set, by name of the scene; none where there is no file."""
    path = root / REVIEW_FILE
    if not path.exists():
        return {}
    return dict(check_review(read_json(path, VERDICTS), path).verdicts)


def check_review(stored: Any, path: Path) -> ReviewFile:
    """Check the JSON value of a file of verdicts; ``path`` is for the message."""
    if isinstance(stored, dict) and stored.get("format") == FORMAT and stored.get("schema") != SCHEMA:
        raise InputError(
            f"{path} has version {str(stored.get('schema'))[:20]} of the format, this version reads {SCHEMA}; upgrade "
            "challenger-bench"
        )
    return validate_stored(
        ReviewFile.model_validate,
        stored,
        lambda where, why: (
            f"{path} is not a valid review: {f'{where[:120]}: ' if where else ''}{why}; fix it, or move it away and "
            "run challenger-bench data review again"
        ),
    )


def check_verdict(stored: Any, what: str) -> Verdict:
    """Check the JSON value of one verdict; ``what`` names it in the message."""
    return validate_stored(
        Verdict.model_validate,
        stored,
        lambda where, why: (
            f"{what} is not a valid verdict: {f'{where}: ' if where else ''}{why}; a verdict is "
            "accepted or rejected, and a rejection has a reason"
        ),
    )


def resolve_verdicts(
    verdicts: Mapping[str, Verdict], tokens: Mapping[str, str], left_out: Mapping[str, StandingVerdict] | None = None
) -> SplitReview:
    """Verdicts that stand, and scenes that have none; all by scene name, ``tokens`` from the rows of scenes."""
    judged = dict(left_out or {})
    waiting, outdated = [], []
    for name, token in tokens.items():
        verdict = verdicts.get(name)
        if verdict is not None and verdict.token == token:
            judged[name] = StandingVerdict(name, token, verdict.verdict, verdict.reason)
        else:
            waiting.append(name)
            outdated += [] if verdict is None else [name]
    return SplitReview(tuple(judged[name] for name in sorted(judged)), tuple(waiting), tuple(outdated))
