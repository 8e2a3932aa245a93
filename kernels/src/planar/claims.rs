//! Whose each triangle is: of a patch that stands, or claimed by one that grows.
//!
//! Patches that grow at the same time each have a turn, the number of their seed. Of two that claim a triangle the
//! one with the earlier turn gets it, and the other one is spoiled: it does not grow as it would have in its turn.

use std::sync::atomic::{AtomicBool, AtomicU8, AtomicU32, Ordering::Relaxed};

use crate::base::parallel::{collect, update};

/// Nobody's.
const FREE: u32 = u32::MAX;

/// In a patch that is not to be changed. Other patches that stand are their number and one more.
const TAKEN: u32 = 0;

/// What a claim is more than the turn; numbers of patches are less.
const CLAIM: u32 = 1 << 31;

/// A triangle may be set free so often; then it only joins patches that never set any free. Keeps the time linear.
const MOST_RELEASES: u8 = 3;

/// How a triangle looks to a patch that grows.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Whose {
    /// Nobody's, or of a patch with a later turn.
    Free,
    /// Its own, or of a patch that stands.
    Settled,
    /// Of a patch with an earlier turn.
    Earlier,
}

pub struct Claims {
    of: Vec<AtomicU32>,
    releases: Vec<AtomicU8>,
    /// By turn. Empty where patches grow one after the other, which makes claiming simpler.
    spoiled: Vec<AtomicBool>,
}

impl Claims {
    /// On so many triangles, none of which is taken unless `is_taken` says so.
    pub fn new(count: usize, threads: usize, is_taken: impl Fn(usize) -> bool + Sync) -> Self {
        let whose = |t| AtomicU32::new(if is_taken(t) { TAKEN } else { FREE });
        Self {
            of: collect(count, threads, whose),
            releases: collect(count, threads, |_| AtomicU8::new(0)),
            spoiled: vec![],
        }
    }

    /// Let patches grow at the same time, of so many turns; of none, one after the other.
    pub fn share(&mut self, turns: usize) {
        self.spoiled = (0..turns).map(|_| AtomicBool::new(false)).collect();
    }

    /// The claim of a turn.
    pub fn of_turn(turn: usize) -> u32 {
        CLAIM + turn as u32
    }

    /// The claim of a patch that nothing can come before: it stands as soon as it has grown.
    pub fn of_patch(patch: usize) -> u32 {
        patch as u32 + 1
    }

    /// The patch that a triangle is in; none for one that is not in any, or in one that is not to be changed.
    #[inline]
    pub fn patch(&self, t: u32) -> Option<u32> {
        let of = self.of[t as usize].load(Relaxed);
        (of != TAKEN && of < CLAIM).then(|| of - 1)
    }

    /// Whether a triangle is in a patch that stands.
    #[inline]
    pub fn is_settled(&self, t: u32) -> bool {
        self.of[t as usize].load(Relaxed) < CLAIM
    }

    /// Whether a triangle is nobody's, not even claimed.
    #[inline]
    pub fn is_free(&self, t: u32) -> bool {
        self.of[t as usize].load(Relaxed) == FREE
    }

    #[inline]
    pub fn whose(&self, t: u32, claim: u32) -> Whose {
        let of = self.of[t as usize].load(Relaxed);
        if of > claim {
            Whose::Free
        } else if of == claim || of < CLAIM {
            Whose::Settled
        } else {
            Whose::Earlier
        }
    }

    /// Claim a free triangle; false if an earlier patch has just done so.
    #[inline]
    pub fn claim(&self, t: u32, claim: u32) -> bool {
        let slot = &self.of[t as usize];
        if self.spoiled.is_empty() {
            slot.store(claim, Relaxed);
            return true;
        }
        let was = slot.fetch_min(claim, Relaxed);
        if was > claim && was != FREE {
            self.spoiled[(was - CLAIM) as usize].store(true, Relaxed);
        }
        was > claim
    }

    /// Give a claim up.
    pub fn release(&self, t: u32, claim: u32) {
        // Whoever has taken it over keeps it.
        let _ = self.of[t as usize].compare_exchange(claim, FREE, Relaxed, Relaxed);
    }

    /// A triangle that was claimed is of the patch with this number.
    #[inline]
    pub fn settle(&self, t: u32, patch: u32) {
        self.of[t as usize].store(patch + 1, Relaxed);
    }

    /// Set a triangle of a patch free.
    pub fn unsettle(&self, t: u32) {
        self.of[t as usize].store(FREE, Relaxed);
    }

    pub fn spoil(&self, turn: usize) {
        if let Some(spoiled) = self.spoiled.get(turn) {
            spoiled.store(true, Relaxed);
        }
    }

    pub fn is_spoiled(&self, turn: usize) -> bool {
        self.spoiled.get(turn).is_some_and(|spoiled| spoiled.load(Relaxed))
    }

    /// A turn begins anew.
    pub fn start(&self, turn: usize) {
        if let Some(spoiled) = self.spoiled.get(turn) {
            spoiled.store(false, Relaxed);
        }
    }

    /// Whether a triangle was set free so often that it no longer joins patches that may set it free again.
    #[inline]
    pub fn is_restless(&self, t: u32) -> bool {
        self.releases[t as usize].load(Relaxed) >= MOST_RELEASES
    }

    /// Count that a triangle was set free.
    pub fn count_release(&self, t: u32) {
        let releases = &self.releases[t as usize];
        releases.store(releases.load(Relaxed).saturating_add(1), Relaxed);
    }

    /// Give the patches that stand other numbers.
    pub fn renumber(&mut self, threads: usize, number: &[u32]) {
        update(&mut self.of, threads, |_, of| {
            let of = of.get_mut();
            if *of != TAKEN && *of < CLAIM {
                *of = number[*of as usize - 1] + 1;
            }
        });
    }
}
