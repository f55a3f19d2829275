"""Everything here needs the extra `alpasim`."""

from importlib.util import find_spec

collect_ignore_glob = [] if find_spec("grpc") else ["test_*.py"]
