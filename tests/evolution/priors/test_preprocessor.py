"""The preprocessor: grid search, contradictions, and the distributions that they give."""

import numpy as np
import pytest

from caterpillar_env.errors import CaterpillarError
from evolution.genome import Gene
from evolution.priors.distributions import ClippedGaussian, Uniform, WrappedGaussian
from evolution.priors.preprocessor import DesignParameter, preprocess, search_grid

A, B, C = (Gene(name, name, "m", 0.0, 1.0, name) for name in ("a", "b", "c"))
CIRCLE = Gene("phase", "p", "1", 0.0, 1.0, "phase", circular=True)


def k(name, genes, formula):
    return DesignParameter(name, "", "", genes, formula)


@pytest.mark.parametrize(("optimum", "node"), [(0.37, 3), (0.40, 4), (0.5 + 1e-6, 5), (0.95, 9)])
def test_interior_optimum_peaks_at_the_nearest_of_ten_nodes(optimum, node):
    rows = preprocess([k("K", ("a",), lambda a: -((a - optimum) ** 2))], [A])
    assert rows[0].distribution.mu == pytest.approx(node / 9)


def test_grid_spans_the_genes_own_range():
    gene = Gene("a", "a", "m", 10.0, 19.0, "a")  # nodes at 10, 11, ... 19
    rows = preprocess([k("K", ("a",), lambda a: -((a - 12.2) ** 2))], [gene])
    assert rows[0].to_dict()["mu"] == pytest.approx(12.0)


def test_optimum_off_the_axes_is_found_by_searching_all_nodes():
    # The best a depends on b, so no search along one axis at a time from a corner finds it.
    formula = k("K", ("a", "b"), lambda a, b: -100 * (a - b) ** 2 - (b - 2 / 3) ** 2)
    assert search_grid(formula, (A, B)).best == (6, 6)


def test_parameters_that_agree_share_one_gaussian():
    rows = preprocess([k("K1", ("a",), lambda a: a), k("K2", ("a", "b"), lambda a, b: a - b)], [A, B])
    assert rows[0].distribution == ClippedGaussian.with_floor(1.0)
    assert rows[1].distribution == ClippedGaussian.with_floor(0.0)
    assert rows[0].signs == (("K1", 1), ("K2", 1))
    assert rows[1].signs == (("K2", -1),)


def test_parameters_that_disagree_leave_the_gene_uniform():
    rows = preprocess([k("K1", ("a",), lambda a: a), k("K2", ("a", "b"), lambda a, b: b - a)], [A, B])
    assert rows[0].distribution == Uniform()
    assert rows[0].reason.startswith("contradiction")
    assert rows[1].distribution == ClippedGaussian.with_floor(1.0)


def test_gene_in_no_parameter_stays_uniform():
    rows = preprocess([k("K", ("a",), lambda a: a)], [A, C])
    assert rows[1].distribution == Uniform()
    assert rows[1].gene is C


def test_without_parameters_everything_is_uniform():
    assert [r.distribution for r in preprocess([], [A, B])] == [Uniform(), Uniform()]


def test_parameter_that_ignores_a_gene_it_lists_is_refused():
    with pytest.raises(CaterpillarError, match="K does not depend on b"):
        preprocess([k("K", ("a", "b"), lambda a, b: a + 0 * b)], [A, B])


def test_parameter_that_is_constant_is_refused():
    with pytest.raises(CaterpillarError, match="does not depend on a"):
        preprocess([k("K", ("a",), np.ones_like)], [A])


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_parameter_that_is_not_finite_at_one_node_is_refused(value):
    formula = k("K", ("a", "b"), lambda a, b: np.where((a == 0) & (b == 1), value, a + b))
    with pytest.raises(CaterpillarError, match="K must be finite"):
        preprocess([formula], [A, B])


def test_parameter_over_an_unknown_gene_is_refused():
    with pytest.raises(CaterpillarError, match="no such genes: nose"):
        preprocess([k("K", ("a", "nose"), lambda a, nose: a + nose)], [A])


def test_parameters_with_the_same_name_are_refused():
    twins = [k("K", ("a",), lambda a: a), k("K", ("a",), lambda a: -a)]
    with pytest.raises(CaterpillarError, match="K"):
        preprocess(twins, [A])


def test_disagreement_can_be_resolved_by_the_product():
    # K1 falls from 1 to 1/2 and K2 rises from 0 to 1; (1 - a / 2) a is largest at the last node.
    falling, rising = k("K1", ("a",), lambda a: 1 - a / 2), k("K2", ("a",), lambda a: a)
    (row,) = preprocess([falling, rising], [A], contradictions="product")
    assert row.distribution == ClippedGaussian.with_floor(1.0)
    assert row.reason.startswith("best product (K1 wants 0 mm; K2 wants 1e+03 mm)")
    # (1 - a) a is largest in the middle; of the two nodes there, the first is taken.
    (row,) = preprocess([falling._replace(formula=lambda a: 1 - a), rising], [A], 3.0, "product")
    assert row.distribution == ClippedGaussian.with_floor(4 / 9)


def test_product_takes_the_other_genes_at_their_best():
    # K2 prefers a = 1 only where b is 0, but its best node has b = 1.
    second = k("K2", ("a", "b"), lambda a, b: b * (2 - a) + (1 - b) * a)
    rows = preprocess([k("K1", ("a",), lambda a: a**4), second], [A, B], contradictions="product")
    assert rows[0].distribution == ClippedGaussian.with_floor(1.0)
    assert rows[1].distribution == ClippedGaussian.with_floor(1.0)


def test_product_requires_positive_values():
    negative, rising = k("K1", ("a",), lambda a: a - 2), k("K2", ("a",), lambda a: 1 - a)
    with pytest.raises(CaterpillarError, match="K1 must have positive values"):
        preprocess([negative, rising], [A], contradictions="product")


def test_gene_stays_uniform_if_the_product_is_zero_everywhere():
    low, high = k("K1", ("a",), lambda a: 0.5 - a), k("K2", ("a",), lambda a: a - 0.95)
    (row,) = preprocess([low, high], [A], contradictions="product")
    assert row.distribution == Uniform()
    assert row.reason.startswith("contradiction")


@pytest.mark.parametrize("contradictions", ["uniform", "product"])
def test_parameter_with_several_best_nodes_agrees_with_any_of_them(contradictions):
    flat, peaked = k("K1", ("a",), lambda a: np.minimum(a, 0.5)), k("K2", ("a",), lambda a: a)
    (row,) = preprocess([flat, peaked], [A], contradictions=contradictions)
    assert row.distribution == ClippedGaussian.with_floor(1.0)
    assert row.reason == "best node of K1 and K2"


def test_agreement_does_not_depend_on_how_contradictions_are_resolved():
    parameters = [k("K1", ("a",), lambda a: a), k("K2", ("a", "b"), lambda a, b: a - b)]
    assert preprocess(parameters, [A, B]) == preprocess(parameters, [A, B], contradictions="product")


@pytest.mark.parametrize(("optimum", "place"), [(0.42, 0.4), (0.93, 0.9), (0.97, 0.0)])
def test_nodes_of_a_circular_gene_do_not_repeat_its_bounds(optimum, place):
    closeness = k("K", ("phase",), lambda p: np.cos(2 * np.pi * (p - optimum)))
    (row,) = preprocess([closeness], [CIRCLE])
    assert row.distribution == WrappedGaussian.with_floor(place)
    assert row.signs == (("K", 0),)
