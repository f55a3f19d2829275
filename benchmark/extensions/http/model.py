"""A planner behind HTTP: any server of ``/alive``, ``/reset`` and ``/infer``, as in the forks for NeuroNCAP.

The protocol has no identity: results are stored under the name that the user gives, or the server's address.
"""

import sys
from typing import Any, Final

from benchmark.errors import InputError
from benchmark.extensions.http.answers import ModelAnswer
from benchmark.extensions.http.connection import HttpConnection, HttpReply, ServerHungUpError
from benchmark.extensions.http.session import build_request
from benchmark.extensions.http.values import AUTO, HttpImageFormat, NeuroncapHttpError
from benchmark.machine.address import ALIVE_S, DEADLINE_S, RETURN_S, Address
from benchmark.machine.extension import require_extra
from benchmark.planning import (
    ModelFailedError,
    Observation,
    Plan,
    PlanFrame,
    PlannerGoneError,
    PlannerLateError,
    SceneInfo,
)
from benchmark.untrusted.files import HTTP_ANSWER, to_one_line
from benchmark.untrusted.text_files import parse_json

RESET_BODY: Final = b"{}"
_OPTION: Final = "--model"
_BUSY: Final = (408, 503, 504)
_LEAST_ERROR: Final = 400
_LEAST_FAILURE: Final = 500


class HttpPlanner:
    """A planner that is asked over HTTP, with its pictures in one form and its answers in one frame."""

    def __init__(
        self, address: Address, form: HttpImageFormat | None, deadline_s: float, frame: PlanFrame = PlanFrame.EGO
    ) -> None:
        """Nothing is asked yet; no form tries each. The frame of the protocol's answers is ``ego``."""
        self.name = address.name
        self.settings: dict[str, Any] = {**address.settings, "image_format": AUTO if form is None else form.value}
        if frame is not PlanFrame.EGO:
            self.settings["frame"] = frame.value
        self.address = address
        self.form = form
        self.frame = frame
        self._connection = HttpConnection(address.url, "the model server", deadline_s)
        self._told = False
        self._answered = False

    def reset(self, scene: SceneInfo) -> None:
        """Forget the previous scene; of the new one the protocol says nothing."""
        self._reset()

    def _reset(self) -> None:
        reply = self._connection.post("/reset", RESET_BODY)
        self._require_server(reply, "/reset")
        if reply.status >= _LEAST_FAILURE:
            raise ModelFailedError(f"{self._who} failed to reset (status {reply.status}): {_read_detail(reply)}")

    def plan(self, observation: Observation) -> Plan:
        """Ask for a plan, once; it is in the frame of the model's answers.

        Without a form, the first plan is asked for in each, with a reset between, until there is one.

        Raises:
            InputError: If a picture is missing.
            PlannerGoneError: If there is no answer, or it is not from a model server.
            PlannerLateError: If it takes too long.
            ModelFailedError: If it answers anything that NeuroNCAP would not take, or that is no plan.
        """
        reply, answer = self._ask(observation)
        if reply.status >= _LEAST_ERROR and not self._told:
            self._told = True
            print(
                f"{self._who} returns plans with status {reply.status}; the status is ignored, as in NeuroNCAP",
                file=sys.stderr,
            )
        try:
            return answer.plan(self.frame)
        except NeuroncapHttpError as error:
            raise ModelFailedError(f"{self._who} returned a plan that cannot be driven: {error}") from error

    def _ask(self, observation: Observation) -> tuple[HttpReply, ModelAnswer]:
        """The reply with an answer, in the known form or else in the first in which there is one."""
        forms = list(HttpImageFormat) if self.form is None else [self.form]
        failures: list[str] = []
        while True:
            form = forms.pop(0)
            if failures:
                # A model that failed half-way may remember what it saw.
                self._reset()
            try:
                reply = self._connection.post("/infer", build_request(observation, form).encoded())
            except ServerHungUpError as error:
                if forms:
                    failures.append(f"no answer to images as {form.value}")
                    continue
                raise ServerHungUpError(f"{error}{self._advise(form)}") from error
            try:
                answer = ModelAnswer.read(reply.body)
            except NeuroncapHttpError as error:
                failure = f"status {reply.status}: {_read_detail(reply)}" if reply.status >= _LEAST_ERROR else error
                failures.append(f"{failure}" if self.form else f"{failure} to images as {form.value}")
                if forms and reply.status not in _BUSY and not reply.is_page:
                    continue
                self._require_server(reply, "/infer")
                hint = self._advise(form) if reply.status >= _LEAST_FAILURE else ""
                raise ModelFailedError(f"{self._who} returned no plan ({'; '.join(failures)}){hint}") from error
            if self.form is None:
                print(f"{self._who} reads images as {form.value}", file=sys.stderr, flush=True)
            self.form, self._answered = form, True
            return reply, answer

    def _advise(self, form: HttpImageFormat) -> str:
        """What else to try with a server that fails before its first plan, as where it cannot read the images."""
        if self._answered or self.form is None:
            return ""
        other = HttpImageFormat.TORCH if form is HttpImageFormat.PNG else HttpImageFormat.PNG
        return f"; if it cannot read images as {form.value}, try --image-format {other.value}, or auto, to try both"

    def come_back(self) -> None:
        """Wait for a server that went away (`benchmark.planning.RemotePlanner`)."""
        print(f"{self._who} is gone; waiting at most {RETURN_S:g} s for it to return", file=sys.stderr, flush=True)
        self._connection.wait(RETURN_S)

    def require_alive(self) -> None:
        """Refuse an address without a server; any answer to ``/alive`` will do, as for NeuroNCAP."""
        require_extra("httpx2", "asking over HTTP", "serve")
        self._connection.get("/alive", ALIVE_S)

    @property
    def _who(self) -> str:
        return f"the model server at {self.address.url}"

    def _require_server(self, reply: HttpReply, path: str) -> None:
        """Tell a server that cannot be meant from a model that failed."""
        if reply.status in _BUSY:
            raise PlannerLateError(
                f"{self._who} was too busy for {path} (status {reply.status}): {_read_detail(reply)}"
            )
        if reply.is_page:
            raise PlannerGoneError(
                f"{self._who} answers {path} with a web page (status {reply.status}); this is not a model server; name "
                "another address"
            )
        if _LEAST_ERROR <= reply.status < _LEAST_FAILURE:
            raise PlannerGoneError(
                f"{self._who} refuses {path} (status {reply.status}: {_read_detail(reply)}); it speaks another version "
                "of NeuroNCAP's protocol, needs another --image-format, or is not a model server"
            )


def http_planner(
    address: str,
    *,
    image_format: str = HttpImageFormat.TORCH,
    deadline_s: float = DEADLINE_S,
    frame: str = PlanFrame.EGO,
) -> HttpPlanner:
    """The planner at ``http://HOST:PORT`` or ``NAME=http://HOST:PORT``; nothing is asked yet.

    ``image_format`` is ``torch``, as NeuroNCAP sends pictures, ``png``, or ``auto``, which tries both; answers are in
    the frame ``ego``, as the protocol has it, or ``lidar``.
    """
    if image_format not in (AUTO, *HttpImageFormat):
        raise InputError(f"a model at http:// is sent torch, png or auto; --image-format {image_format} is for grpc://")
    form = None if image_format == AUTO else HttpImageFormat(image_format)
    return HttpPlanner(Address.of(address, _OPTION), form, deadline_s, PlanFrame(frame))


def _read_detail(reply: HttpReply) -> str:
    """A server's words about an error, without the object that frameworks put around them."""
    try:
        value = parse_json(reply.body, HTTP_ANSWER)
    except ValueError:
        return reply.said
    detail = value.get("detail") if isinstance(value, dict) else None
    return to_one_line(detail, 300) if isinstance(detail, str) else reply.said
