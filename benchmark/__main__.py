"""``python -m benchmark`` is ``challenger-bench``."""

from benchmark.cli import main

main()
