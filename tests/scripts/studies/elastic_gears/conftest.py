import pytest

import jaxcslc as jc
from scripts.studies.likelihood.two_masses import TwoMasses, network_of_two_masses, two_masses


@pytest.fixture(scope="session")
def network() -> jc.CSLC:
    return network_of_two_masses()


@pytest.fixture(scope="session")
def with_play() -> TwoMasses:
    return two_masses(4e-3)


@pytest.fixture(scope="session")
def without_play() -> TwoMasses:
    return two_masses(0.0)
