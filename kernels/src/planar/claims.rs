//! Ownership of triangles during speculative patch growth: settled in a patch, claimed by a growing one, or
//! free.
//!
//! Patches that grow concurrently are ordered by turn, the index of their seed. If two claim the same
//! triangle, the earlier turn gets it. The other patch is then spoiled, because it no longer grows as it
//! would in its turn.

use std::sync::atomic::{AtomicBool, AtomicU8, AtomicU32, Ordering::Relaxed};

use crate::base::parallel::{collect, update};

/// Unowned triangle.
const FREE: u32 = u32::MAX;

/// Triangle of a fixed patch. Other settled triangles store their patch index plus one.
const FIXED: u32 = 0;

/// Offset of claims: a claim stores its turn plus this, which exceeds all patch indices.
const CLAIM_OFFSET: u32 = 1 << 31;

/// Number of releases after which a triangle only joins patches that never release triangles. It keeps the
/// run time linear.
const MAX_RELEASES: u8 = 3;

/// Ownership of a triangle, from the point of view of a growing patch.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum ClaimState {
    /// Unowned, or claimed by a later turn.
    Free,
    /// Claimed by this patch, or settled.
    Settled,
    /// Claimed by an earlier turn.
    Earlier,
}

/// Ownership state of all triangles.
pub struct Claims {
    owners: Vec<AtomicU32>,
    releases: Vec<AtomicU8>,
    /// Spoiled flag of each turn. Empty for sequential growth, which needs no atomic claims.
    spoiled: Vec<AtomicBool>,
}

impl Claims {
    /// Create the state of `count` triangles; those selected by `is_taken` are fixed.
    pub fn new(count: usize, threads: usize, is_taken: impl Fn(usize) -> bool + Sync) -> Self {
        let whose = |t| AtomicU32::new(if is_taken(t) { FIXED } else { FREE });
        Self {
            owners: collect(count, threads, whose),
            releases: collect(count, threads, |_| AtomicU8::new(0)),
            spoiled: vec![],
        }
    }

    /// Enable concurrent growth of `turns` patches; 0 selects sequential growth.
    pub fn enable_turns(&mut self, turns: usize) {
        self.spoiled = (0..turns).map(|_| AtomicBool::new(false)).collect();
    }

    /// Return the claim of a turn.
    pub fn of_turn(turn: usize) -> u32 {
        CLAIM_OFFSET + turn as u32
    }

    /// Return the claim of a patch with nothing before it, which is settled as soon as it has grown.
    pub fn of_patch(patch: usize) -> u32 {
        patch as u32 + 1
    }

    /// Return the settled patch of a triangle. None if it has no patch or belongs to a fixed one.
    #[inline]
    pub fn patch(&self, t: u32) -> Option<u32> {
        let of = self.owners[t as usize].load(Relaxed);
        (of != FIXED && of < CLAIM_OFFSET).then(|| of - 1)
    }

    /// Check whether a triangle belongs to a settled patch.
    #[inline]
    pub fn is_settled(&self, t: u32) -> bool {
        self.owners[t as usize].load(Relaxed) < CLAIM_OFFSET
    }

    /// Check whether a triangle is neither settled nor claimed.
    #[inline]
    pub fn is_free(&self, t: u32) -> bool {
        self.owners[t as usize].load(Relaxed) == FREE
    }

    /// Return the ownership of a triangle, as viewed by the patch with this claim.
    #[inline]
    pub fn claim_state(&self, t: u32, claim: u32) -> ClaimState {
        let of = self.owners[t as usize].load(Relaxed);
        if of > claim {
            ClaimState::Free
        } else if of == claim || of < CLAIM_OFFSET {
            ClaimState::Settled
        } else {
            ClaimState::Earlier
        }
    }

    /// Claim a free triangle. Returns false if an earlier patch has claimed it meanwhile.
    #[inline]
    pub fn claim(&self, t: u32, claim: u32) -> bool {
        let slot = &self.owners[t as usize];
        if self.spoiled.is_empty() {
            slot.store(claim, Relaxed);
            return true;
        }
        let was = slot.fetch_min(claim, Relaxed);
        if was > claim && was != FREE {
            self.spoiled[(was - CLAIM_OFFSET) as usize].store(true, Relaxed);
        }
        was > claim
    }

    /// Release a claim.
    pub fn release(&self, t: u32, claim: u32) {
        // Has no effect if another patch has taken the triangle over.
        let _ = self.owners[t as usize].compare_exchange(claim, FREE, Relaxed, Relaxed);
    }

    /// Assign a claimed triangle to a settled patch.
    #[inline]
    pub fn settle(&self, t: u32, patch: u32) {
        self.owners[t as usize].store(patch + 1, Relaxed);
    }

    /// Release a settled triangle.
    pub fn release_settled(&self, t: u32) {
        self.owners[t as usize].store(FREE, Relaxed);
    }

    /// Mark the patch of a turn as spoiled.
    pub fn spoil(&self, turn: usize) {
        if let Some(spoiled) = self.spoiled.get(turn) {
            spoiled.store(true, Relaxed);
        }
    }

    /// Check whether the patch of a turn is spoiled.
    pub fn is_spoiled(&self, turn: usize) -> bool {
        self.spoiled.get(turn).is_some_and(|spoiled| spoiled.load(Relaxed))
    }

    /// Clear the spoiled flag of a turn that starts again.
    pub fn restart(&self, turn: usize) {
        if let Some(spoiled) = self.spoiled.get(turn) {
            spoiled.store(false, Relaxed);
        }
    }

    /// Check whether a triangle was released so often that it no longer joins patches that may release it.
    #[inline]
    pub fn is_release_limited(&self, t: u32) -> bool {
        self.releases[t as usize].load(Relaxed) >= MAX_RELEASES
    }

    /// Count a release of a triangle.
    pub fn count_release(&self, t: u32) {
        let releases = &self.releases[t as usize];
        releases.store(releases.load(Relaxed).saturating_add(1), Relaxed);
    }

    /// Renumber the settled patches.
    pub fn renumber(&mut self, threads: usize, number: &[u32]) {
        update(&mut self.owners, threads, |_, of| {
            let of = of.get_mut();
            if *of != FIXED && *of < CLAIM_OFFSET {
                *of = number[*of as usize - 1] + 1;
            }
        });
    }
}
