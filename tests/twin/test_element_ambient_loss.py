"""Linear loss: from one node, or from several that are alike."""

import pytest

from tests.twin.two_nodes import heat, network, worst_error
from twin.network import TwinFileError
from twin.twinfile import dump, parse

LOSS = '[elements.x]\nkind = "ambient_loss"\nnode = "a"\nhA = 3.0\n'


def test_one_node_and_several() -> None:
    assert heat(LOSS) == pytest.approx([-60.0, 0.0])
    assert heat(LOSS + 'alike = ["b"]\n') == pytest.approx([-60.0, -30.0])


def test_kernel_agrees_with_solve_ivp() -> None:
    assert worst_error(LOSS + 'alike = ["b"]\n') < 1e-6


def test_written_and_read_again() -> None:
    for text in (LOSS, LOSS + 'alike = ["b"]\n'):
        net = network(text)
        assert parse(dump(net)).elements == net.elements


def test_a_node_is_named_once() -> None:
    with pytest.raises(TwinFileError, match="named twice"):
        network(LOSS + 'alike = ["a"]\n')
