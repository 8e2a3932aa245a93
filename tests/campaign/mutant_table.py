"""Rules of the kernels, each with a change that breaks it and the Rust test that must fail.

Each text occurs exactly once in its file. If the code changes, its row must change as well.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Mutant:
    """Mutation of the source that breaks a rule.

    Attributes
    ----------
    rule : rule that no longer holds.
    file : path relative to the root of the checkout.
    text, replacement : original and mutated source.
    test : name of a Rust test that must fail.
    """

    rule: str
    file: str
    text: str
    replacement: str
    test: str


_LEGALITY = "kernels/src/mesh/collapse_legality.rs"
_PIECE = "kernels/src/certify/piece_bounds.rs"
_REFINE = "kernels/src/certify/refinement.rs"
_DECIDE = "kernels/src/certify/decision.rs"
_COVER = "kernels/src/certify/coverage_proof.rs"
_ENGINE = "kernels/src/collapse/engine.rs"
_PLACEMENT = "kernels/src/quadrics/placement.rs"
_QEM = "kernels/src/quadric/qem.rs"
_INTEGRATE = "kernels/src/fusion/integration.rs"
_CUBES = "kernels/src/fusion/cube_table.rs"
_SURFACE = "kernels/src/fusion/surface_extraction.rs"

MUTANTS: dict[str, Mutant] = {
    "bridge": Mutant(
        "an edge across the interior between two boundary vertices does not collapse",
        _LEGALITY,
        "if !on_boundary && ends_on_boundary == [true, true] {",
        "if !on_boundary && ends_on_boundary == [true, true] && marks.stamp == u32::MAX {",
        "what_may_collapse_on_a_sheet",
    ),
    "lone-triangle": Mutant(
        "the last triangle of a connected component is kept",
        _LEGALITY,
        "if on_boundary && is_open(Connectivity::next(first)) && is_open(Connectivity::prev(first)) {",
        "if on_boundary && is_open(first) && !is_open(first) {",
        "no_piece_or_hole_may_vanish",
    ),
    "tetrahedron": Mutant(
        "a tetrahedron is kept",
        _LEGALITY,
        "valence == [3, 3] && ends_on_boundary == [false, false];",
        "valence == [2, 2] && ends_on_boundary == [false, false];",
        "no_piece_or_hole_may_vanish",
    ),
    "link": Mutant(
        "an edge whose ends share another neighbour than the corners of its triangles does not collapse",
        _LEGALITY,
        "if shared != beside || tetrahedron {",
        "if shared < beside || tetrahedron {",
        "a_waist_of_three_edges_may_not_vanish",
    ),
    "slack-of-shape": Mutant(
        "a shape bound contains the slack of searches",
        _PIECE,
        "let shape = farthest_corner(&part).reach + self.slack;",
        "let shape = 0.5 * farthest_corner(&part).reach + self.slack;",
        "no_point_is_farther_than_its_triangles_bound",
    ),
    "far-reach": Mutant(
        "the bound of a region follows from its farthest corner",
        _PIECE,
        "let shape = (far.reach + self.slack).min(parent.shape);",
        "let shape = (0.5 * far.reach + self.slack).min(parent.shape);",
        "no_point_is_farther_than_its_triangles_bound",
    ),
    "passed": Mutant(
        "a decision is negative if a point exceeds the limit",
        _REFINE,
        "let passed = goal.decide && !outcome.attained.is_within(goal.at_most);",
        "let passed = goal.decide && outcome.attained.is_within(goal.at_most);",
        "a_decision_agrees_with_the_bounds",
    ),
    "unproven-part": Mutant(
        "an unproven region makes the mesh unproven",
        _DECIDE,
        "if !outcome.bound.is_within(goal.at_most) {",
        "if !outcome.bound.is_within(goal.at_most) && seen.pieces == 0 {",
        "an_unproven_part_leaves_the_whole_unproven",
    ),
    "cover-limit": Mutant(
        "the quick proof keeps the slack within the limit",
        _COVER,
        "let most = limit.shape - against.slack;",
        "let most = 2.0 * limit.shape - against.slack;",
        "no_point_exceeds_a_proven_limit",
    ),
    "fold": Mutant(
        "no triangle flips",
        _LEGALITY,
        "let folds = dot(&reference, &new) < least * (old_area2 * new_area2).sqrt();",
        "let folds = dot(&reference, &new) < -2.0 * (old_area2 * new_area2).sqrt();",
        "no_triangle_turns_over",
    ),
    "needle": Mutant(
        "no triangle degenerates to a line",
        _LEGALITY,
        "if new_area2 <= least2 * new_side2 * new_side2",
        "if new_area2 < 0.0 * new_side2",
        "no_triangle_becomes_a_line",
    ),
    "fold-asked": Mutant(
        "every proposed collapse is checked for folds",
        _ENGINE,
        "check_triangles(&self.star, &proposal.point).map_err(Refusal::Illegal)?;",
        "let _ = check_triangles(&self.star, &proposal.point);",
        "no_triangle_turns_over",
    ),
    "both-locked": Mutant(
        "an edge between two locked vertices does not collapse",
        _ENGINE,
        "if self.star.end_is_fixed == [true, true] {",
        "if self.star.end_is_fixed == [true, true] && self.attempts == 0 {",
        "fixed_vertices_stay_bit_for_bit",
    ),
    "locked-survives": Mutant(
        "the locked end of an edge survives",
        _QEM,
        "[_, true] => 1,",
        "[_, true] => 0,",
        "fixed_vertices_stay_bit_for_bit",
    ),
    "locked-place": Mutant(
        "an edge with a locked end collapses to that end, with its attributes",
        _QEM,
        "position(|&v| mesh.lock(v) == VertexLock::Locked);",
        "position(|&v| mesh.lock(v) == VertexLock::Rim);",
        "fixed_vertices_stay_bit_for_bit",
    ),
    "merge-order": Mutant(
        "priorities of successive merges never decrease",
        _ENGINE,
        "|last| last.priority.max(priority));",
        "|_| priority);",
        "priorities_of_merges_never_fall",
    ),
    "best-place": Mutant(
        "a vertex moves to the minimum of the error, not to the midpoint",
        _PLACEMENT,
        "const TETHER_STRENGTH: f64 = 1e-9;",
        "const TETHER_STRENGTH: f64 = 1e-1;",
        "the_best_place_is_where_the_planes_meet",
    ),
    "tether": Mutant(
        "among equal minima, a vertex moves to the one closest to the midpoint",
        _PLACEMENT,
        "together.minimum(&midpoint(ends[0], ends[1]), TETHER_STRENGTH)",
        "together.minimum(ends[0], TETHER_STRENGTH)",
        "on_a_plane_the_best_place_is_above_the_middle",
    ),
    "shorter-first": Mutant(
        "among edges without error, the shorter collapses first",
        _PLACEMENT,
        "const LENGTH_COST_FACTOR: f64 = 1e-10;",
        "const LENGTH_COST_FACTOR: f64 = -1e-10;",
        "shorter_edge_without_cost_goes_first",
    ),
    "sign": Mutant(
        "points in front of the surface have a positive distance",
        _INTEGRATE,
        "distance[i] = if is_inside & is_known { found } else { f32::NEG_INFINITY };",
        "distance[i] = if is_inside & is_known { -found } else { f32::NEG_INFINITY };",
        "voxels_hold_what_double_precision_and_no_tricks_say",
    ),
    "behind": Mutant(
        "voxels more than a truncation behind the surface are unobserved",
        _INTEGRATE,
        "let is_seen = d > -1.0;",
        "let is_seen = d > -2.0;",
        "voxels_hold_what_double_precision_and_no_tricks_say",
    ),
    "full-weight": Mutant(
        "sums and weights are halved before the weights overflow",
        _INTEGRATE,
        "let sum = if is_full { sums[i] * 0.5 } else { sums[i] };",
        "let sum = sums[i];",
        "thousands_of_frames_leave_no_bias",
    ),
    "downwards": Mutant(
        "a negative coordinate is in the block below",
        "kernels/src/fusion/touched_blocks.rs",
        "*place = cut - i32::from(at < cut as f32);",
        "*place = cut;",
        "places_are_cut_off_downwards_and_wide_instructions_do_the_same",
    ),
    "most-blocks": Mutant(
        "a volume has at most its maximum number of blocks",
        "kernels/src/fusion/block_storage.rs",
        "if wanted > self.max_count {",
        "if wanted > self.max_count + 1 {",
        "what_does_not_fit_is_not_begun",
    ),
    "faces": Mutant(
        "all six faces of a cube are processed",
        _CUBES,
        "for number in 0..6 {",
        "for number in 0..5 {",
        "every_cube_is_filled_with_its_loops_as_the_only_border",
    ),
    "diagonals": Mutant(
        "no diagonal of a cube is in one of its faces",
        _CUBES,
        "b - a < 2 || !share_face(around[a], around[b]);",
        "b - a < 99 || !share_face(around[a], around[b]);",
        "every_cube_is_filled_with_its_loops_as_the_only_border",
    ),
    "two-fans": Mutant(
        "two cubes that share only an edge have separate vertices",
        _SURFACE,
        "if cubes == 0b0101 || cubes == 0b1010 {",
        "if cubes == 0b0101 {",
        "any_signs_with_any_gaps_give_a_manifold",
    ),
    "halo": Mutant(
        "the surface of a brick needs a rim of blocks on all sides",
        _SURFACE,
        "high: own.high.map(|c| c + 1) });",
        "high: own.high });",
        "pieces_with_a_rim_give_the_whole_to_the_bit",
    ),
}
