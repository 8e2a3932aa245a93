"""Rules of the kernels, each with a change that breaks it and the Rust test that has to notice.

A text stands exactly once in its file; where the code changes, its row changes with it.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Mutant:
    """A rule that is broken.

    Attributes
    ----------
    rule : what no longer holds.
    file : relative to the root of the checkout.
    text, replacement : the source as it is, and as it must not be.
    test : the name of a Rust test that fails then.
    """

    rule: str
    file: str
    text: str
    replacement: str
    test: str


_LEGALITY = "kernels/src/mesh/legality.rs"
_PIECE = "kernels/src/certify/piece.rs"
_REFINE = "kernels/src/certify/refine.rs"
_DECIDE = "kernels/src/certify/decide.rs"
_COVER = "kernels/src/certify/cover.rs"
_ENGINE = "kernels/src/collapse/engine.rs"
_PLACEMENT = "kernels/src/quadrics/placement.rs"
_QEM = "kernels/src/quadric/qem.rs"

MUTANTS: dict[str, Mutant] = {
    "bridge": Mutant(
        "an edge across the interior between two boundary vertices does not collapse",
        _LEGALITY,
        "if !on_boundary && ends_on_boundary == [true, true] {",
        "if !on_boundary && ends_on_boundary == [true, true] && marks.stamp == u32::MAX {",
        "what_may_collapse_on_a_sheet",
    ),
    "lone-triangle": Mutant(
        "the last triangle of a piece stays",
        _LEGALITY,
        "if on_boundary && is_open(Connectivity::next(first)) && is_open(Connectivity::prev(first)) {",
        "if on_boundary && is_open(first) && !is_open(first) {",
        "no_piece_or_hole_may_vanish",
    ),
    "tetrahedron": Mutant(
        "a tetrahedron stays",
        _LEGALITY,
        "valence == [3, 3] && ends_on_boundary == [false, false];",
        "valence == [2, 2] && ends_on_boundary == [false, false];",
        "no_piece_or_hole_may_vanish",
    ),
    "link": Mutant(
        "ends that share a neighbour beyond their triangles stay apart",
        _LEGALITY,
        "if shared != beside || tetrahedron {",
        "if shared < beside || tetrahedron {",
        "a_waist_of_three_edges_may_not_vanish",
    ),
    "slack-of-shape": Mutant(
        "a bound on shape contains the slack of searches",
        _PIECE,
        "let shape = farthest(&part).reach + self.slack;",
        "let shape = 0.5 * farthest(&part).reach + self.slack;",
        "no_point_is_farther_than_its_triangles_bound",
    ),
    "far-reach": Mutant(
        "a piece is bounded by its farthest corner",
        _PIECE,
        "let shape = (far.reach + self.slack).min(parent.shape);",
        "let shape = (0.5 * far.reach + self.slack).min(parent.shape);",
        "no_point_is_farther_than_its_triangles_bound",
    ),
    "passed": Mutant(
        "a decision ends with no where a point passes the limit",
        _REFINE,
        "let passed = goal.decide && !outcome.attained.within(goal.at_most);",
        "let passed = goal.decide && outcome.attained.within(goal.at_most);",
        "a_decision_agrees_with_the_bounds",
    ),
    "unproven-part": Mutant(
        "a part that is not proven keeps the whole from being proven",
        _DECIDE,
        "if !outcome.bound.within(goal.at_most) {",
        "if !outcome.bound.within(goal.at_most) && seen.pieces == 0 {",
        "a_part_that_is_not_proven_keeps_the_whole_from_being_proven",
    ),
    "cover-limit": Mutant(
        "the quick proof keeps the slack within the limit",
        _COVER,
        "let most = limit.shape - against.slack;",
        "let most = 2.0 * limit.shape - against.slack;",
        "no_point_of_a_triangle_said_to_stay_within_a_limit_passes_it",
    ),
    "fold": Mutant(
        "no triangle turns over",
        _LEGALITY,
        "if cosine < least * (old_area2 * new_area2).sqrt() {",
        "if cosine < -2.0 * (old_area2 * new_area2).sqrt() {",
        "no_triangle_turns_over",
    ),
    "needle": Mutant(
        "no triangle becomes a line",
        _LEGALITY,
        "if new_area2 <= least2 * new_side2 * new_side2",
        "if new_area2 < 0.0 * new_side2",
        "no_triangle_becomes_a_line",
    ),
    "fold-asked": Mutant(
        "every proposal is asked whether it folds a triangle",
        _ENGINE,
        "keeps_triangles(&self.star, &proposal.point).map_err(Refusal::Illegal)?;",
        "let _ = keeps_triangles(&self.star, &proposal.point);",
        "no_triangle_turns_over",
    ),
    "both-locked": Mutant(
        "an edge between two locked vertices does not collapse",
        _ENGINE,
        "if self.star.end_stays == [true, true] {",
        "if self.star.end_stays == [true, true] && self.attempts == 0 {",
        "fixed_vertices_stay_bit_for_bit",
    ),
    "locked-survives": Mutant(
        "of an edge with one locked end the locked one survives",
        _QEM,
        "[_, true] => 1,",
        "[_, true] => 0,",
        "fixed_vertices_stay_bit_for_bit",
    ),
    "locked-place": Mutant(
        "an edge with a locked end becomes that end, attributes included",
        _QEM,
        "position(|&v| mesh.lock(v) == Lock::Locked);",
        "position(|&v| mesh.lock(v) == Lock::Rim);",
        "fixed_vertices_stay_bit_for_bit",
    ),
    "merge-order": Mutant(
        "priorities never fall from one merge to the next",
        _ENGINE,
        "|last| last.priority.max(priority));",
        "|_| priority);",
        "priorities_of_merges_never_fall",
    ),
    "best-place": Mutant(
        "a vertex goes where the error is least, not to the middle",
        _PLACEMENT,
        "const TETHER: f64 = 1e-9;",
        "const TETHER: f64 = 1e-1;",
        "the_best_place_is_where_the_planes_meet",
    ),
    "tether": Mutant(
        "where many places are as good, a vertex goes to that nearest the middle of its edge",
        _PLACEMENT,
        "together.minimum(&midpoint(ends[0], ends[1]), TETHER)",
        "together.minimum(ends[0], TETHER)",
        "on_a_plane_the_best_place_is_above_the_middle",
    ),
    "shorter-first": Mutant(
        "of edges that cost nothing the shorter goes first",
        _PLACEMENT,
        "const SHORTER_FIRST: f64 = 1e-10;",
        "const SHORTER_FIRST: f64 = -1e-10;",
        "of_edges_that_cost_nothing_the_shorter_goes_first",
    ),
}
