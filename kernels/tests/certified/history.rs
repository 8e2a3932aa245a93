//! Undo of collapses: every intermediate state is a valid mesh, and undoing all collapses restores the input.

use crate::promises::common::{Noise, Triangles, coloured, gallery, torus};
use scanloom_kernels::base::progress::{Progress, RunControl};
use scanloom_kernels::certified::collapse_history::History;
use scanloom_kernels::certified::input_surface::InputSurface;
use scanloom_kernels::collapse::collapse_log::RegionLog;
use scanloom_kernels::collapse::rounds::{Goal, collapse};
use scanloom_kernels::collapse::whole_mesh::WholeMesh;
use scanloom_kernels::mesh::connectivity::Connectivity;
use scanloom_kernels::quadric::qem::QemState;

/// A remaining triangle: its input index, the input indices of its corners, and their positions.
type RemainingTriangle = (u32, [u32; 3], [[f64; 6]; 3]);

/// Simplify to a tenth in small regions; returns the remaining triangles and the logs.
fn simplified(points: &[[f64; 6]], triangles: &Triangles) -> (Vec<RemainingTriangle>, Vec<RegionLog<6>>) {
    let whole = WholeMesh::<6, ()>::new(points.to_vec(), triangles.clone(), vec![]).unwrap();
    let records = QemState::<3> { weight: 0.01, importance: vec![] };
    let goal = Goal {
        triangles: triangles.len() / 10,
        threads: 2,
        region: 60,
        min_collapse_ratio: 0.0,
        record_positions: true,
    };
    let control = RunControl::default();
    let outcome = collapse(whole, records, &goal, &mut Progress::new(&control)).unwrap();
    let mesh = outcome.mesh;
    let left = mesh.triangles.iter().zip(&mesh.triangle_source).map(|(corners, &source)| {
        (source, corners.map(|v| mesh.vertex_source[v as usize]), corners.map(|v| mesh.points[v as usize]))
    });
    (left.collect(), outcome.logs)
}

fn remaining_triangles(history: &History<'_, 6>, triangles: &Triangles) -> Triangles {
    (0..triangles.len() as u32).filter_map(|t| history.corners(t)).collect()
}

fn meshes() -> Vec<(&'static str, Vec<[f64; 6]>, Triangles)> {
    let mut all = gallery();
    let (points, triangles) = torus(24, 16);
    all.push(("large torus", points, triangles));
    all.into_iter()
        .map(|(name, points, triangles)| (name, coloured::<6>(&points, 0.1, 7), triangles))
        .collect()
}

#[test]
fn history_reproduces_the_final_mesh() {
    for (name, points, triangles) in meshes() {
        let (left, logs) = simplified(&points, &triangles);
        let original = InputSurface::new(points, triangles.clone());
        let mut history = History::new(&original, false);
        history.append(logs);
        assert_eq!(remaining_triangles(&history, &triangles).len(), left.len(), "{name}");
        for (source, corners, places) in left {
            let mut known = history.corners(source).unwrap();
            // Compare up to rotation of the corners.
            while known[0] != corners[0] {
                known.rotate_left(1);
            }
            assert_eq!(known, corners, "{name}");
            assert_eq!(corners.map(|v| history.point(v)), places, "{name}");
        }
    }
}

#[test]
fn undo_keeps_the_topology() {
    let mut noise = Noise(11);
    for (name, points, triangles) in meshes() {
        let topology = Connectivity::from_triangles(points.len(), &triangles).unwrap().topology();
        let (_, logs) = simplified(&points, &triangles);
        let original = InputSurface::new(points.clone(), triangles.clone());
        let mut history = History::new(&original, false);
        history.append(logs);
        while history.active_count() > 0 {
            let before = remaining_triangles(&history, &triangles);
            let corners = before[noise.below(before.len())];
            let Some(latest) = history.last_collapse_of_triangle(&corners) else { continue };
            let (count, mut splits) = (history.active_count(), 0);
            history.undo(latest, &mut |history, around_one, around_both| {
                splits += 1;
                // Each collapse had removed one or two triangles.
                let gained = around_both.len() - around_one.len();
                assert!(gained == 1 || gained == 2, "{name}: {gained}");
                assert!(around_one.iter().all(|t| around_both.contains(t)), "{name}");
                assert!(around_both.iter().all(|&t| history.corners(t).is_some()), "{name}");
            });
            assert_eq!(history.active_count() + splits, count, "{name}");
            let now = remaining_triangles(&history, &triangles);
            assert!(now.len() > before.len(), "{name}");
            let mesh = Connectivity::from_triangles(points.len(), &now).unwrap();
            assert_eq!(mesh.topology(), topology, "{name}");
        }
        assert_eq!(remaining_triangles(&history, &triangles), triangles, "{name}");
        assert!((0..points.len() as u32).all(|v| history.point(v) == points[v as usize]), "{name}");
    }
}

#[test]
fn undo_affects_only_dependent_collapses() {
    let (points, triangles) = torus(24, 16);
    let points = coloured::<6>(&points, 0.1, 7);
    let (_, logs) = simplified(&points, &triangles);
    let original = InputSurface::new(points, triangles.clone());
    for number in [0, 40, 150, 250] {
        let mut history = History::new(&original, false);
        history.append(logs.clone());
        let before: Vec<_> = (0..triangles.len() as u32).map(|t| history.corners(t)).collect();
        let mut touched = vec![];
        history.undo(number, &mut |_, _, around_both| touched.extend_from_slice(around_both));
        for (t, corners) in before.into_iter().enumerate() {
            assert!(history.corners(t as u32) == corners || touched.contains(&(t as u32)));
        }
        // Undoing it again does nothing.
        let kept = history.active_count();
        history.undo(number, &mut |_, _, _| panic!("undone twice"));
        assert_eq!(history.active_count(), kept);
    }
}

#[test]
fn replay_leads_to_the_current_mesh() {
    for (name, points, triangles) in meshes() {
        let (_, logs) = simplified(&points, &triangles);
        let original = InputSurface::new(points.clone(), triangles.clone());
        let mut history = History::new(&original, true);
        history.append(logs);
        for share in 1..4 {
            let numbers: Vec<u32> =
                (0..points.len() as u32).filter_map(|v| history.last_collapse_of_vertex(v)).collect();
            let some = numbers.iter().filter(|number| *number % 4 == share);
            some.for_each(|&number| history.undo(number, &mut |_, _, _| ()));
            let way = history.replay_sequence();
            assert_eq!(way.survivor_points.len(), history.active_count(), "{name}");
            let (mut places, mut into) = (points.clone(), (0..points.len() as u32).collect::<Vec<_>>());
            for ((&removed, &survivor), to) in way.removed.iter().zip(&way.survivor).zip(&way.survivor_points)
            {
                assert_eq!((into[removed as usize], into[survivor as usize]), (removed, survivor), "{name}");
                into[removed as usize] = survivor;
                places[survivor as usize] = *to;
            }
            for v in 0..points.len() as u32 {
                let mut root = v;
                while into[root as usize] != root {
                    root = into[root as usize];
                }
                assert_eq!((root, places[root as usize]), (history.root(v), history.point(root)), "{name}");
            }
        }
    }
}
