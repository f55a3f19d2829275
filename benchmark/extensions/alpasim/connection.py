"""Calls of AlpaSim's services over gRPC: bytes in and out, a deadline on each, failures as a closed list.

No answer, or a connection lost half-way, is `PlannerAwayError`; a late answer `PlannerLateError`; another kind of
server `PlannerGoneError`; an error of the policy `ModelFailedError`. Calls are never repeated.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Final

from benchmark.extensions.alpasim.messages import EGODRIVER, METHODS, decode_message, encode_message
from benchmark.planning import ModelFailedError, PlannerAwayError, PlannerGoneError, PlannerLateError
from benchmark.untrusted.files import GRPC_MESSAGE, GRPC_PICTURE, to_one_line

if TYPE_CHECKING:
    import grpc

MESSAGE_BYTES: Final = 64 << 20
CONTRACT: Final = "carla-driver-interface-contract"
"""Metadata of one package of drivers: 1 where ``rig_to_camera`` is the camera's body, 2 or nothing where it is as
AlpaSim has it."""
Metadata = Sequence[tuple[str, str]]


class EgodriverConnection:
    """A channel to one address, named ``what`` in messages; made at the first call. Paths begin with ``prefix``."""

    def __init__(self, url: str, what: str, deadline_s: float, prefix: str = EGODRIVER) -> None:
        self.url, self.deadline_s, self._prefix = url, deadline_s, prefix
        self._where = f"{what} at {url}"
        self._channel: grpc.Channel | None = None

    def call(self, method: str, message: Any, deadline_s: float | None = None, metadata: Metadata = ()) -> Any:
        """The answer to one call."""
        return self.call_together([(method, message)], deadline_s, metadata)[0][0]

    def call_together(
        self, calls: Sequence[tuple[str, Any]], deadline_s: float | None = None, metadata: Metadata = ()
    ) -> list[tuple[Any, dict[str, str]]]:
        """Answers to several calls under way at the same time, with their initial metadata; the first failure."""
        import grpc

        seconds = self.deadline_s if deadline_s is None else deadline_s
        channel, waiting = self._open(), []
        for method, message in calls:
            # Requests and answers are bytes, so that what comes in is bounded before it is decoded.
            send = channel.unary_unary(self._prefix + method, request_serializer=None, response_deserializer=None)
            try:
                waiting.append(send.future(encode_message(message), timeout=seconds, metadata=tuple(metadata)))
            except ValueError as error:
                raise PlannerAwayError(f"{self._where} cannot be asked ({to_one_line(error, 80)})") from error
        answers, failure = [], None
        for (method, _), future in zip(calls, waiting, strict=True):
            try:
                answers.append((future.result(), dict(future.initial_metadata() or ())))
            except grpc.RpcError as error:
                failure = failure or self._describe(method, error, seconds)
            except grpc.FutureCancelledError as error:
                failure = failure or PlannerAwayError(f"{self._where}: {method} was broken off ({error})")
        if failure is not None:
            raise failure
        return [(self._decode(method, data), meta) for (method, _), (data, meta) in zip(calls, answers, strict=True)]

    def wait(self, seconds: float) -> None:
        """Wait until something listens there; then `PlannerAwayError`."""
        import grpc

        try:
            grpc.channel_ready_future(self._open()).result(timeout=seconds)
        except grpc.FutureTimeoutError:
            self.close()
            raise PlannerAwayError(
                f"nobody answers at {self.url}; start it there, then the same command again"
            ) from None

    def close(self) -> None:
        """End the connection; the next call makes another."""
        channel, self._channel = self._channel, None
        if channel is not None:
            channel.close()

    def _open(self) -> "grpc.Channel":
        if self._channel is None:
            import grpc

            options = [
                ("grpc.max_receive_message_length", GRPC_PICTURE.file_bytes),
                ("grpc.max_send_message_length", MESSAGE_BYTES),
                ("grpc.initial_reconnect_backoff_ms", 100),
                ("grpc.max_reconnect_backoff_ms", 1000),
                ("grpc.enable_http_proxy", 0),
            ]
            self._channel = grpc.insecure_channel(self.url.removeprefix("grpc://"), options=options)
        return self._channel

    def _decode(self, method: str, data: bytes) -> Any:
        try:
            return decode_message(METHODS[self._prefix + method][1], data, GRPC_MESSAGE)
        except ValueError as error:
            raise ModelFailedError(f"{self._where} answered {method} with what cannot be read: {error}") from error

    def _describe(self, method: str, error: Any, seconds: float) -> Exception:
        import grpc

        code, said = error.code(), to_one_line(error.details() or "", 300) or "no reason"
        if code is grpc.StatusCode.DEADLINE_EXCEEDED:
            return PlannerLateError(
                f"{self._where} did not answer {method} within {seconds:g} s; it hangs or is slow; check its log"
            )
        if code in (grpc.StatusCode.UNAVAILABLE, grpc.StatusCode.CANCELLED):
            return PlannerAwayError(
                f"{self._where} is not there for {method} ({said}); look at its log, restart it, then run the same "
                "command again: finished work is kept"
            )
        if code is grpc.StatusCode.UNIMPLEMENTED:
            return PlannerGoneError(
                f"{self._where} has no {method}; it is no {self._prefix[1:].partition('.')[0]} service; check the "
                "address"
            )
        if code is grpc.StatusCode.NOT_FOUND and method not in ("start_session", "close_session"):
            return PlannerAwayError(f"{self._where} has lost its session ({said}): it was started again")
        return ModelFailedError(f"{self._where} failed at {method} (gRPC error {code.name}): {said}{_advise(code)}")


def _advise(code: Any) -> str:
    return "; if pictures are too large for it, send --image-format jpeg" if code.name == "RESOURCE_EXHAUSTED" else ""
