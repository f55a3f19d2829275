"""Several devices in one option: each worker of a command takes one of them, scene after scene."""

from benchmark.errors import InputError
from benchmark.machine.workers import worker_number


def parse_device_names(text: str) -> tuple[str, ...]:
    """Devices by name, at least one, as ``--device`` takes them: for example ``cuda:0,cuda:1``.

    All are of one kind: a record names one, and another one rounds differently.
    """
    names = tuple(name.strip() for name in text.split(","))
    if not all(names):
        raise InputError(f"--device {text!r} has an empty name; separate devices by one comma: cuda:0,cuda:1")
    if len({name.partition(":")[0] for name in names}) > 1:
        raise InputError(f"--device {text} mixes kinds of devices, whose results differ; use one kind")
    return names


def find_own_device(text: str | None) -> str | None:
    """The device of this process: workers take them in turns, and the command itself the first."""
    return None if text is None else find_device_in_turn(text)


def find_device_in_turn(text: str) -> str:
    """`find_own_device` where a device is always named."""
    names = parse_device_names(text)
    return names[worker_number() % len(names)]


def count_workers(workers: int, device: str | None) -> int:
    """How many processes a command asks for: with several devices, one each unless ``--workers`` says how many.

    Fewer processes than devices, of which some would do nothing, are refused.
    """
    count = 1 if device is None else len(parse_device_names(device))
    if count == 1:
        return workers
    if 0 < workers < count:
        raise InputError(
            f"--workers {workers} leaves some of {device} without work; use at least {count}, or fewer devices"
        )
    return workers or count


def require_one_device(text: str | None, why: str) -> None:
    """Refuse several devices where one process does all; ``why`` begins the sentence with what needs one process."""
    if text is not None and len(parse_device_names(text)) > 1:
        raise InputError(f"{why}; use one device instead of --device {text}")
