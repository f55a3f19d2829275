"""Films as bytes: WebM, PNG frames and animated WebP; the same frames give the same bytes."""

import io
from collections.abc import Iterable
from fractions import Fraction
from typing import Any, Final

from PIL import Image

from benchmark.errors import InputError
from benchmark.report.lettering import Picture

FINE, COMPACT = 32, 38
"""VP9's scale from 0 (best) to 63: of scenes, and of drives, which there are many of and whose whole view moves."""
_SPEED: Final = 5
_WEBP_QUALITY: Final = 62


def webm(frames: Iterable[Picture], fps: float, quality: int = FINE) -> bytes:
    """VP9 in WebM of frames, each (h, w, 3) RGB of the same even size; the quality is `FINE` or `COMPACT`."""
    av = _pyav()
    rate = Fraction(fps).limit_denominator(1000)
    target = io.BytesIO()
    # Without bitexact the file has a random identifier and the library's version.
    with av.open(target, "w", format="webm", options={"fflags": "+bitexact"}) as container:
        stream: Any = None
        for frame in frames:
            if stream is None:
                stream = container.add_stream("libvpx-vp9", rate=rate)
                stream.height, stream.width = frame.shape[:2]
                stream.pix_fmt = "yuv420p"
                stream.thread_count = 1
                stream.options = {
                    "crf": str(quality),
                    "b": "0",
                    "deadline": "realtime",
                    "cpu-used": str(_SPEED),
                    "flags": "+bitexact",
                }
            container.mux(stream.encode(av.VideoFrame.from_ndarray(frame, format="rgb24")))
        if stream is not None:
            container.mux(stream.encode(None))
    return target.getvalue()


def animated_webp(frames: Iterable[Picture], fps: float) -> bytes:
    """An animated WebP of frames, each (h, w, 3) RGB of the same size, that repeats for ever.

    For pages that show pictures but no films.
    """
    pictures = [Image.fromarray(frame) for frame in frames]
    # Whole milliseconds that add up to the film's length.
    ends = [round(1000 * (number + 1) / fps) for number in range(len(pictures))]
    durations = [end - start for start, end in zip([0, *ends], ends)]
    target = io.BytesIO()
    pictures[0].save(
        target,
        format="WEBP",
        save_all=True,
        append_images=pictures[1:],
        duration=durations,
        loop=0,
        quality=_WEBP_QUALITY,
        method=4,
        minimize_size=False,
    )
    return target.getvalue()


def require_webm() -> None:
    """Raise `InputError` if WebM files cannot be written here."""
    _pyav()


def _pyav() -> Any:
    try:
        import av
    except ImportError as error:
        raise InputError(
            "WebM films need PyAV, which is not installed; run pip install 'challenger-bench[video]', or choose "
            "--format png or --format webp"
        ) from error
    return av
