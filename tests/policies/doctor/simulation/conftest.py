from functools import partial

import pytest


@pytest.fixture
def simulate_for(monkeypatch):
    """Set the length of simulations, 12.2 s otherwise, for what shows earlier; a goal takes 4 s."""
    from policies.doctor import check_context
    from policies.doctor.simulation.simulated_run import run_simulation

    return lambda s: monkeypatch.setattr(check_context, "run_simulation", partial(run_simulation, seconds=s))


@pytest.fixture
def brief(simulate_for):
    simulate_for(1.0)


@pytest.fixture
def one_goal(simulate_for):
    simulate_for(4.2)


@pytest.fixture
def two_goals(simulate_for):
    simulate_for(8.2)
