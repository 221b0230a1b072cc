import pytest
import report_study

from pipeline import store
from pipeline.report.write import write_report


@pytest.fixture(scope="session")
def results():
    return report_study.study()


@pytest.fixture(scope="session")
def tree(results):
    return store.to_tree(results)


@pytest.fixture(scope="session")
def report(results, tmp_path_factory):
    folder = tmp_path_factory.mktemp("reports") / "made-up"
    write_report(results, folder)
    return folder
