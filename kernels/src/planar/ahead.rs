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
use super::ground::Ground;
use super::growth::{Grower, Grown};
use crate::base::errors::KernelError;
use crate::base::parallel::spawn;
use crate::base::progress::Progress;

/// Speculation starts once a patch takes less than 1/8 of the remaining triangles; larger patches leave no
/// other work.
const MOST: usize = 8;

/// Remaining triangles below which one thread is faster.
const FEW: usize = 1 << 13;

/// Maximum number of threads; more threads mostly wait for each other.
const MOST_THREADS: usize = 2;

/// Initial and maximum number of seeds to skip after a spoiled patch, because an earlier patch is growing
/// there.
const STEPS: [usize; 2] = [1 << 8, 1 << 20];

/// Grow patches from all seeds that no earlier patch has taken. Returns the number of faces visited.
///
/// # Errors
/// [`KernelError::Interrupted`].
pub fn grow_all<const D: usize, const K: usize>(
    ground: &Ground<'_, D>,
    claims: &mut Claims,
    seeds: &[u32],
    grown: &mut Vec<Grown<K>>,
    progress: &mut Progress,
) -> Result<u64, KernelError> {
    let in_patches: usize = grown.iter().map(|grown| grown.patch.faces as usize).sum();
    let left = seeds.len() - in_patches;
    if left == 0 {
        return Ok(0);
    }
    let (mut at, mut looks) = (0, 0);
    grow_alone(ground, claims, seeds, left, &mut at, &mut looks, grown, progress)?;
    if at == seeds.len() {
        return Ok(looks);
    }
    let seeds: Vec<u32> = seeds[at..].iter().copied().filter(|&t| !claims.is_settled(t)).collect();
    claims.share(seeds.len());
    let turns = Turns {
        ground,
        claims,
        seeds: &seeds,
        state: Mutex::new(State {
            at: 0,
            ahead: 0,
            step: STEPS[0],
            slots: BTreeMap::new(),
            grown: std::mem::take(grown),
            looks,
            interrupted: None,
        }),
        changed: Condvar::new(),
    };
    thread::scope(|scope| {
        for _ in 1..ground.options.threads.min(MOST_THREADS) {
            let progress = progress.clone();
            if spawn(scope, || turns.run(progress)).is_none() {
                break;
            }
        }
        turns.run(progress.clone());
    });
    let state = turns.state.into_inner().unwrap_or_else(PoisonError::into_inner);
    *grown = state.grown;
    claims.share(0);
    state.interrupted.map_or(Ok(state.looks), Err)
}

/// Grow patches sequentially until they are small enough for parallel growth.
#[allow(clippy::too_many_arguments)]
fn grow_alone<const D: usize, const K: usize>(
    ground: &Ground<'_, D>,
    claims: &Claims,
    seeds: &[u32],
    mut left: usize,
    at: &mut usize,
    looks: &mut u64,
    grown: &mut Vec<Grown<K>>,
    progress: &mut Progress,
) -> Result<(), KernelError> {
    let mut grower = Grower::new(ground, claims);
    while *at < seeds.len() {
        let turn = *at;
        *at += 1;
        progress.tick(|| (turn as u64 / 2, seeds.len() as u64))?;
        if claims.is_settled(seeds[turn]) {
            continue;
        }
        let claim = Claims::of_patch(grown.len());
        grown.extend(grower.grow(seeds[turn], turn, claim, progress.is_enough()));
        grower.released.iter().for_each(|&t| claims.count_release(t));
        *looks += grower.looks;
        left -= grower.members.len();
        if ground.options.threads > 1 && left > FEW && grower.members.len() < left / MOST {
            break;
        }
    }
    Ok(())
}

/// State of a turn whose growth has started.
enum Slot<const K: usize> {
    Growing,
    Ahead(Box<Ahead<K>>),
    Spoiled,
}

/// Finished patch, possibly ahead of its turn, with the observations that decide on its acceptance.
struct Ahead<const K: usize> {
    grown: Grown<K>,
    members: Vec<u32>,
    released: Vec<u32>,
    barred: Vec<u32>,
    was_restless: bool,
    looks: u64,
}

struct State<const K: usize> {
    /// Current turn; all patches of earlier turns are settled.
    at: usize,
    /// Next turn to consider for speculative growth.
    ahead: usize,
    /// Number of seeds to skip after a spoiled patch.
    step: usize,
    slots: BTreeMap<usize, Slot<K>>,
    grown: Vec<Grown<K>>,
    looks: u64,
    interrupted: Option<KernelError>,
}

/// Shared state of growing patches from `seeds`, each in its turn.
struct Turns<'a, const D: usize, const K: usize> {
    ground: &'a Ground<'a, D>,
    claims: &'a Claims,
    seeds: &'a [u32],
    state: Mutex<State<K>>,
    changed: Condvar,
}

/// Next task of a thread.
enum Task {
    Grow(usize),
    Wait,
    Leave,
}

impl<const D: usize, const K: usize> Turns<'_, D, K> {
    /// Main loop of each thread.
    fn run(&self, mut progress: Progress) {
        let mut grower = Grower::new(self.ground, self.claims);
        let mut state = self.lock();
        loop {
            match self.task(&mut state, &mut progress) {
                Task::Leave => break,
                Task::Wait => state = self.changed.wait(state).unwrap_or_else(PoisonError::into_inner),
                Task::Grow(turn) => {
                    drop(state);
                    let slot = self.grow(&mut grower, turn, progress.is_enough());
                    state = self.lock();
                    self.put(&mut state, turn, slot);
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

    fn grow(&self, grower: &mut Grower<'_, D, K>, turn: usize, is_alone: bool) -> Slot<K> {
        let was_restless = self.claims.is_restless(self.seeds[turn]);
        let grown = grower.grow(self.seeds[turn], turn, Claims::of_turn(turn), is_alone);
        grown.map_or(Slot::Spoiled, |grown| {
            Slot::Ahead(Box::new(Ahead {
                grown,
                members: grower.members.clone(),
                released: grower.released.clone(),
                barred: grower.barred.clone(),
                was_restless,
                looks: grower.looks,
            }))
        })
    }

    fn put(&self, state: &mut State<K>, turn: usize, slot: Slot<K>) {
        if matches!(slot, Slot::Spoiled) {
            state.ahead = state.ahead.max(turn + state.step);
            state.step = (2 * state.step).min(STEPS[1]);
        } else {
            state.step = STEPS[0];
        }
        state.slots.insert(turn, slot);
    }

    fn task(&self, state: &mut State<K>, progress: &mut Progress) -> Task {
        let next = self.settle(state, progress);
        if state.interrupted.is_some() || state.at == self.seeds.len() {
            return Task::Leave;
        }
        match next.or_else(|| self.next_ahead(state)) {
            Some(turn) => {
                state.slots.insert(turn, Slot::Growing);
                Task::Grow(turn)
            }
            None => Task::Wait,
        }
    }

    /// Accept finished patches in order. Returns the current turn if its patch must be grown now.
    fn settle(&self, state: &mut State<K>, progress: &mut Progress) -> Option<usize> {
        while state.at < self.seeds.len() && state.interrupted.is_none() {
            let (turn, all) = (state.at, self.seeds.len() as u64);
            if let Err(error) = progress.tick(|| (turn as u64 / 2, all)) {
                state.interrupted = Some(error);
            }
            let is_settled = self.claims.is_settled(self.seeds[turn]);
            match state.slots.remove(&turn) {
                Some(Slot::Growing) => {
                    state.slots.insert(turn, Slot::Growing);
                    return None;
                }
                Some(Slot::Ahead(ahead)) if self.is_sound(turn, &ahead) => self.stand(state, *ahead),
                Some(Slot::Ahead(ahead)) => {
                    ahead.members.iter().for_each(|&t| self.claims.release(t, Claims::of_turn(turn)));
                    if !is_settled {
                        return Some(turn);
                    }
                }
                Some(Slot::Spoiled) | None => {
                    if !is_settled {
                        return Some(turn);
                    }
                }
            }
            state.at += 1;
        }
        None
    }

    /// Check whether the patch of the current turn would grow identically now.
    fn is_sound(&self, turn: usize, ahead: &Ahead<K>) -> bool {
        let joined_moving = match (ahead.was_restless, ahead.released.is_empty()) {
            (true, _) => &[][..],
            (false, true) => &ahead.members,
            (false, false) => &ahead.released,
        };
        !self.claims.is_spoiled(turn)
            && self.claims.is_restless(self.seeds[turn]) == ahead.was_restless
            && !joined_moving.iter().any(|&t| self.claims.is_restless(t))
            && !ahead.released.iter().any(|&t| self.claims.is_settled(t))
            && ahead.barred.iter().all(|&t| self.claims.is_settled(t))
    }

    fn stand(&self, state: &mut State<K>, ahead: Ahead<K>) {
        let patch = state.grown.len() as u32;
        ahead.members.iter().for_each(|&t| self.claims.settle(t, patch));
        ahead.released.iter().for_each(|&t| self.claims.count_release(t));
        state.looks += ahead.looks;
        state.grown.push(ahead.grown);
    }

    /// Find a later turn whose seed is unclaimed.
    fn next_ahead(&self, state: &mut State<K>) -> Option<usize> {
        let mut turn = state.ahead.max(state.at + 1);
        while turn < self.seeds.len() && !self.claims.is_free(self.seeds[turn]) {
            turn += 1;
        }
        state.ahead = turn + 1;
        (turn < self.seeds.len()).then_some(turn)
    }
}
