//! Speculative parallel growth of all patches, with the same result as sequential growth in seed order.
//!
//! A patch depends on earlier patches only through the triangles they have taken. Idle threads therefore grow
//! patches before their turn, against the current state. In its turn, such a patch is accepted if it would
//! grow identically. No earlier patch may have claimed its triangles, and every triangle it left to earlier
//! patches must be settled. In addition, no triangle may have been released too often since. Otherwise the
//! patch grows again, now with all earlier patches settled. The result is the sequential one; speculation
//! only affects the speed.

use std::collections::BTreeMap;
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::thread;

use super::claims::Claims;
use super::growth_context::GrowthContext;
use super::patch_growth::{Grower, GrownPatch};
use crate::base::errors::KernelError;
use crate::base::parallel::spawn_if_possible;
use crate::base::progress::Progress;

/// Speculation starts once a patch takes less than 1/8 of the remaining triangles; larger patches leave no
/// other work.
const LARGE_PATCH_DIVISOR: usize = 8;

/// Remaining triangles below which one thread is faster.
const MIN_PARALLEL_TRIANGLES: usize = 1 << 13;

/// Maximum number of threads; more threads mostly wait for each other.
const MAX_THREADS: usize = 2;

/// Initial and maximum number of seeds to skip after a spoiled patch, because an earlier patch is growing
/// there.
const SEED_SKIPS: [usize; 2] = [1 << 8, 1 << 20];

/// Grow patches from all seeds that no earlier patch has taken. Returns the number of faces visited.
///
/// # Errors
/// [`KernelError::Interrupted`].
pub fn grow_all<const D: usize, const K: usize>(
    ground: &GrowthContext<'_, D>,
    claims: &mut Claims,
    seeds: &[u32],
    grown: &mut Vec<GrownPatch<K>>,
    progress: &mut Progress,
) -> Result<u64, KernelError> {
    let in_patches: usize = grown.iter().map(|grown| grown.patch.faces as usize).sum();
    let left = seeds.len() - in_patches;
    if left == 0 {
        return Ok(0);
    }
    let (mut at, mut looks) = (0, 0);
    grow_sequentially(ground, claims, seeds, left, &mut at, &mut looks, grown, progress)?;
    if at == seeds.len() {
        return Ok(looks);
    }
    let seeds: Vec<u32> = seeds[at..].iter().copied().filter(|&t| !claims.is_settled(t)).collect();
    claims.enable_turns(seeds.len());
    let turns = SpeculativeGrowth {
        ground,
        claims,
        seeds: &seeds,
        state: Mutex::new(State {
            turn: 0,
            next_speculative: 0,
            seed_skip: SEED_SKIPS[0],
            slots: BTreeMap::new(),
            grown: std::mem::take(grown),
            visited_faces: looks,
            interrupted: None,
        }),
        changed: Condvar::new(),
    };
    thread::scope(|scope| {
        for _ in 1..ground.options.threads.min(MAX_THREADS) {
            let progress = progress.clone();
            if spawn_if_possible(scope, || turns.run(progress)).is_none() {
                break;
            }
        }
        turns.run(progress.clone());
    });
    let state = turns.state.into_inner().unwrap_or_else(PoisonError::into_inner);
    *grown = state.grown;
    claims.enable_turns(0);
    state.interrupted.map_or(Ok(state.visited_faces), Err)
}

/// Grow patches sequentially until they are small enough for parallel growth.
#[allow(clippy::too_many_arguments)]
fn grow_sequentially<const D: usize, const K: usize>(
    ground: &GrowthContext<'_, D>,
    claims: &Claims,
    seeds: &[u32],
    mut left: usize,
    at: &mut usize,
    looks: &mut u64,
    grown: &mut Vec<GrownPatch<K>>,
    progress: &mut Progress,
) -> Result<(), KernelError> {
    let mut grower = Grower::new(ground, claims);
    while *at < seeds.len() {
        let turn = *at;
        *at += 1;
        progress.report_periodically(|| (turn as u64 / 2, seeds.len() as u64))?;
        if claims.is_settled(seeds[turn]) {
            continue;
        }
        let claim = Claims::of_patch(grown.len());
        grown.extend(grower.grow(seeds[turn], turn, claim, progress.is_stopping_early()));
        grower.released.iter().for_each(|&t| claims.count_release(t));
        *looks += grower.visited_faces;
        left -= grower.members.len();
        if ground.options.threads > 1
            && left > MIN_PARALLEL_TRIANGLES
            && grower.members.len() < left / LARGE_PATCH_DIVISOR
        {
            break;
        }
    }
    Ok(())
}

/// State of a turn whose growth has started.
enum TurnState<const K: usize> {
    Growing,
    Finished(Box<SpeculativePatch<K>>),
    Spoiled,
}

/// Finished patch, possibly ahead of its turn, with the observations that decide on its acceptance.
struct SpeculativePatch<const K: usize> {
    grown: GrownPatch<K>,
    members: Vec<u32>,
    released: Vec<u32>,
    blocked: Vec<u32>,
    was_release_limited: bool,
    visited_faces: u64,
}

struct State<const K: usize> {
    /// Current turn; all patches of earlier turns are settled.
    turn: usize,
    /// Next turn to consider for speculative growth.
    next_speculative: usize,
    /// Number of seeds to skip after a spoiled patch.
    seed_skip: usize,
    slots: BTreeMap<usize, TurnState<K>>,
    grown: Vec<GrownPatch<K>>,
    visited_faces: u64,
    interrupted: Option<KernelError>,
}

/// Shared state of growing patches from `seeds`, each in its turn.
struct SpeculativeGrowth<'a, const D: usize, const K: usize> {
    ground: &'a GrowthContext<'a, D>,
    claims: &'a Claims,
    seeds: &'a [u32],
    state: Mutex<State<K>>,
    changed: Condvar,
}

/// Next task of a thread.
enum Task {
    Grow(usize),
    Wait,
    Stop,
}

impl<const D: usize, const K: usize> SpeculativeGrowth<'_, D, K> {
    /// Main loop of each thread.
    fn run(&self, mut progress: Progress) {
        let mut grower = Grower::new(self.ground, self.claims);
        let mut state = self.lock();
        loop {
            match self.next_task(&mut state, &mut progress) {
                Task::Stop => break,
                Task::Wait => state = self.changed.wait(state).unwrap_or_else(PoisonError::into_inner),
                Task::Grow(turn) => {
                    drop(state);
                    let slot = self.grow(&mut grower, turn, progress.is_stopping_early());
                    state = self.lock();
                    self.store_result(&mut state, turn, slot);
                    self.changed.notify_all();
                }
            }
        }
        drop(state);
        self.changed.notify_all();
    }

    fn lock(&self) -> MutexGuard<'_, State<K>> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn grow(&self, grower: &mut Grower<'_, D, K>, turn: usize, is_alone: bool) -> TurnState<K> {
        let was_restless = self.claims.is_release_limited(self.seeds[turn]);
        let grown = grower.grow(self.seeds[turn], turn, Claims::of_turn(turn), is_alone);
        grown.map_or(TurnState::Spoiled, |grown| {
            TurnState::Finished(Box::new(SpeculativePatch {
                grown,
                members: grower.members.clone(),
                released: grower.released.clone(),
                blocked: grower.blocked.clone(),
                was_release_limited: was_restless,
                visited_faces: grower.visited_faces,
            }))
        })
    }

    fn store_result(&self, state: &mut State<K>, turn: usize, slot: TurnState<K>) {
        if matches!(slot, TurnState::Spoiled) {
            state.next_speculative = state.next_speculative.max(turn + state.seed_skip);
            state.seed_skip = (2 * state.seed_skip).min(SEED_SKIPS[1]);
        } else {
            state.seed_skip = SEED_SKIPS[0];
        }
        state.slots.insert(turn, slot);
    }

    fn next_task(&self, state: &mut State<K>, progress: &mut Progress) -> Task {
        let next = self.accept_finished(state, progress);
        if state.interrupted.is_some() || state.turn == self.seeds.len() {
            return Task::Stop;
        }
        match next.or_else(|| self.find_speculative_turn(state)) {
            Some(turn) => {
                state.slots.insert(turn, TurnState::Growing);
                Task::Grow(turn)
            }
            None => Task::Wait,
        }
    }

    /// Accept finished patches in order. Returns the current turn if its patch must be grown now.
    fn accept_finished(&self, state: &mut State<K>, progress: &mut Progress) -> Option<usize> {
        while state.turn < self.seeds.len() && state.interrupted.is_none() {
            let (turn, all) = (state.turn, self.seeds.len() as u64);
            if let Err(error) = progress.report_periodically(|| (turn as u64 / 2, all)) {
                state.interrupted = Some(error);
            }
            let is_settled = self.claims.is_settled(self.seeds[turn]);
            match state.slots.remove(&turn) {
                Some(TurnState::Growing) => {
                    state.slots.insert(turn, TurnState::Growing);
                    return None;
                }
                Some(TurnState::Finished(ahead)) if self.is_reproducible(turn, &ahead) => {
                    self.accept(state, *ahead)
                }
                Some(TurnState::Finished(ahead)) => {
                    ahead.members.iter().for_each(|&t| self.claims.release(t, Claims::of_turn(turn)));
                    if !is_settled {
                        return Some(turn);
                    }
                }
                Some(TurnState::Spoiled) | None => {
                    if !is_settled {
                        return Some(turn);
                    }
                }
            }
            state.turn += 1;
        }
        None
    }

    /// Check whether the patch of the current turn would grow identically now.
    fn is_reproducible(&self, turn: usize, ahead: &SpeculativePatch<K>) -> bool {
        let joined_moving = match (ahead.was_release_limited, ahead.released.is_empty()) {
            (true, _) => &[][..],
            (false, true) => &ahead.members,
            (false, false) => &ahead.released,
        };
        !self.claims.is_spoiled(turn)
            && self.claims.is_release_limited(self.seeds[turn]) == ahead.was_release_limited
            && !joined_moving.iter().any(|&t| self.claims.is_release_limited(t))
            && !ahead.released.iter().any(|&t| self.claims.is_settled(t))
            && ahead.blocked.iter().all(|&t| self.claims.is_settled(t))
    }

    fn accept(&self, state: &mut State<K>, ahead: SpeculativePatch<K>) {
        let patch = state.grown.len() as u32;
        ahead.members.iter().for_each(|&t| self.claims.settle(t, patch));
        ahead.released.iter().for_each(|&t| self.claims.count_release(t));
        state.visited_faces += ahead.visited_faces;
        state.grown.push(ahead.grown);
    }

    /// Find a later turn whose seed is unclaimed.
    fn find_speculative_turn(&self, state: &mut State<K>) -> Option<usize> {
        let mut turn = state.next_speculative.max(state.turn + 1);
        while turn < self.seeds.len() && !self.claims.is_free(self.seeds[turn]) {
            turn += 1;
        }
        state.next_speculative = turn + 1;
        (turn < self.seeds.len()).then_some(turn)
    }
}
