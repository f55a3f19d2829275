"""A planner behind the wire, without a socket: requests in, answers out, one scene at a time.

The protocol names neither client nor scene. Whoever posts ``/reset`` begins a scene; an ``/infer`` whose time does not
go on belongs to another one, and is refused rather than put into the planner's memory.
"""

import sys

from benchmark.errors import InputError
from benchmark.extensions.http.answers import ModelAnswer
from benchmark.extensions.http.images import TENSOR_FLAG
from benchmark.extensions.http.observed import SCENE, Memory
from benchmark.extensions.http.requests import InferRequest, encoded
from benchmark.extensions.http.values import WireError
from benchmark.planning import Plan, Planner, PrivilegedPlanner, SceneInfo, remembers_across_scenes
from benchmark.runs.plan_rows import FAILURES, seed_everything
from benchmark.untrusted.files import one_line
from benchmark.untrusted.wire_images import TensorRefused

UNSUPPORTED, UNREADABLE, CONFLICT, FAILED = 415, 422, 409, 500
"""Statuses of HTTP."""


class Refused(Exception):
    """A request that is not answered with a plan: an HTTP status, and a sentence for the client."""

    def __init__(self, status: int, sentence: str) -> None:
        super().__init__(sentence)
        self.status = status


class Session:
    """One planner and the scene that it is in. Nothing here is safe to call from two threads at once."""

    def __init__(self, planner: Planner, *, tensors: bool = False, seed: int = 0) -> None:
        """Wrap a planner that has just been built; it must not want more than the wire carries.

        Args:
            tensors: Whether saved tensors of PyTorch are read.
            seed: Of global generators, at every reset.
        """
        if isinstance(planner, PrivilegedPlanner):
            raise InputError(
                f"{planner.name} sees boxes, the map or the recorded path, and none of them is on the wire; serve a "
                "planner that sees what a car sees"
            )
        if remembers_across_scenes(planner):
            raise InputError(f"{planner.name} remembers across scenes, and /reset is there to forget them")
        self.planner = planner
        self._tensors = tensors
        self._seed = seed
        self._memory = Memory()
        self._begun = False

    def reset(self) -> bytes:
        """Begin a scene, always; gives the body of the answer.

        Raises:
            Refused: If the planner fails in it.
        """
        self._memory = Memory()
        self._begun = False
        try:
            self._begin()
        except FAILURES as error:
            raise self._failed("reset", error) from error
        return encoded(True)

    def infer(self, body: bytes) -> bytes:
        """Answer one posted observation with a body.

        Raises:
            Refused: If it cannot be read, does not go on from the last one, or the planner fails.
        """
        try:
            request = InferRequest.read(body)
            self._require_later(request.timestamp)
            observation = self._memory.observation(request, tensors=self._tensors)
        except TensorRefused as refused:
            raise Refused(
                UNSUPPORTED,
                f"{refused}; send PNG or JPEG, or start the server with {TENSOR_FLAG} if you trust who asks",
            ) from refused
        except WireError as error:
            raise Refused(UNREADABLE, str(error)) from error
        try:
            if not self._begun:
                self._begin()
            plan = self.planner.plan(observation)
            if not isinstance(plan, Plan):
                raise TypeError(f"answered {type(plan).__name__}, a planner answers benchmark.planning.Plan")
            return ModelAnswer.of_plan(plan, float(request.lidar2ego[0, 3])).encoded()
        except FAILURES as error:
            raise self._failed("plan", error) from error

    def _begin(self) -> None:
        # As in this process: what draws from global generators draws the same in every scene's place.
        seed_everything(self._seed, self.planner)
        self.planner.reset(SceneInfo(SCENE, "", ()))
        self._begun = True

    def _require_later(self, timestamp: int) -> None:
        last = self._memory.last_us
        if last is not None and timestamp <= last:
            raise Refused(
                CONFLICT,
                f"timestamp {timestamp} does not go on from {last}, which was asked last: this server holds one scene "
                "at a time; post /reset before another scene, and no request twice",
            )

    def _failed(self, doing: str, error: BaseException) -> Refused:
        """The planner's failure in a sentence, here and for the client."""
        sentence = f"{self.planner.name} failed to {doing}: {type(error).__name__}: {one_line(error) or 'no reason'}"
        print(sentence, file=sys.stderr, flush=True)
        return Refused(FAILED, sentence)
