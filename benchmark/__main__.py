"""``python -m benchmark`` is ``challenger-bench``."""

from benchmark.cli.app import main

main()
