"""Options that name a server: it answers, what it needs is installed, and nothing contradicts it."""

from collections.abc import Sequence

from benchmark import api
from benchmark.cli.preflight_names import require_package
from benchmark.errors import InputError

NEEDS = "{what} needs the package {package}; install it with: pip install 'challenger-bench[serve]'"


def require_servers(
    models: Sequence[str], image_format: str | None, sensor: str = "none", *, tensors: bool = False
) -> None:
    """Refuse servers that do not answer, and options that are about servers where none is named.

    Args:
        models: As ``--model`` takes them.
        image_format: As ``--image-format`` takes it.
        sensor: As ``--sensor`` takes it.
        tensors: Whether ``--accept-torch-tensors`` was given.

    Raises:
        InputError: If one is no address, nobody answers there, or a model behind HTTP would be sent no pictures.
    """
    from benchmark.machine.address import Address, is_address
    from benchmark.machine.extension import from_extension

    served = [each for each in models if is_address(each)]
    if image_format is not None and not served:
        raise InputError("--image-format says how pictures are sent to a model at http://HOST:PORT; leave it out")
    if tensors and not is_address(sensor):
        raise InputError("--accept-torch-tensors belongs to a renderer at --sensor http://HOST:PORT; leave it out")
    api.require_sensor(sensor)
    if not served and not is_address(sensor):
        return
    require_package("httpx2", NEEDS.format(what="asking over HTTP", package="httpx2"))
    for each in served:
        from_extension("planner", "http")(each).require_alive()
    if is_address(sensor):
        from_extension("sensor", "http")(Address.of(sensor, "--sensor")).require_alive()


def require_frame(models: Sequence[str], frame: str | None, *, of_file: bool = False) -> None:
    """Refuse ``--frame`` where no file and no model behind HTTP is named: classes say in which frame they plan.

    Args:
        models: As ``--model`` takes them.
        frame: As ``--frame`` takes it.
        of_file: Whether plans of a file are judged.

    Raises:
        InputError: If there is nothing that the option could be about.
    """
    from benchmark.machine.address import is_address

    if frame is not None and not of_file and not any(map(is_address, models)):
        raise InputError(
            "--frame says in which frame a file or a model at http://HOST:PORT plans; a class says so with PlanFrame "
            "in its Plan, leave --frame out"
        )
