import pytest

from benchmark.evaluation import evaluate
from benchmark.records.run import RunRecord
from tests.benchmark.fake_data import town_of_two
from tests.benchmark.planners import Failing, Straight


@pytest.fixture(scope="session")
def real(tmp_path_factory: pytest.TempPathFactory) -> RunRecord:
    """A run with contacts and failed samples, judged by every protocol; nobody changes its files."""
    return evaluate(town_of_two(slow_leader=True), "val", Failing(), tmp_path_factory.mktemp("real"))


@pytest.fixture(scope="session")
def sound(tmp_path_factory: pytest.TempPathFactory) -> RunRecord:
    """A complete run; nobody changes its files."""
    return evaluate(town_of_two(), "val", Straight(), tmp_path_factory.mktemp("sound"))
