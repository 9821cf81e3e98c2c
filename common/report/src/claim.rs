//! Claims on time: what each record asserts of a span, and which assertion counts where several overlap.

use std::collections::BTreeSet;

use crate::class::{Class, Group};

/// Which claim counts where several overlap: the smallest rank.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Rank {
    /// Light of the sky was collected.
    Light,
    /// Between sunrise and sunset an action was under way.
    WorkInDaylight,
    /// Between sunrise and sunset nothing was under way.
    Daytime,
    /// The verdict, or a suspension.
    Verdict,
    /// A fault.
    Fault,
    /// A part of a row that was measured by itself.
    Timed,
    /// A step of an action.
    Step,
    /// No action was under way.
    Idle,
    /// A short pause between two actions that nothing else explains.
    Between,
}

/// A span of time, ms since the beginning of the report, that a record claims for a class.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Claim {
    /// The first ms.
    pub from_ms: i64,
    /// The ms after the last.
    pub to_ms: i64,
    /// Its rank.
    pub rank: Rank,
    /// Its class.
    pub class: Class,
}

/// A piece of the night in one class.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Piece {
    /// The first ms.
    pub from_ms: i64,
    /// The ms after the last.
    pub to_ms: i64,
    /// Its class.
    pub class: Class,
}

/// Divides the time from 0 to `length_ms` among the claims: each ms is in exactly one piece, in order.
///
/// Of the claims of one rank, the one that began first counts, then the one that was listed first.
pub fn divide(length_ms: i64, claims: &[Claim]) -> Vec<Piece> {
    let inside = |at: i64| at.clamp(0, length_ms.max(0));
    let mut edges: Vec<(i64, bool, usize)> = Vec::with_capacity(2 * claims.len());
    for (index, claim) in claims.iter().enumerate() {
        let (from, to) = (inside(claim.from_ms), inside(claim.to_ms));
        if from < to {
            edges.extend([(from, true, index), (to, false, index)]);
        }
    }
    edges.sort_unstable();
    let mut active: BTreeSet<(Rank, i64, usize)> = BTreeSet::new();
    let (mut pieces, mut at, mut next): (Vec<Piece>, i64, usize) = (Vec::new(), 0, 0);
    while at < length_ms {
        while let Some((_, begins, index)) = edges.get(next).filter(|edge| edge.0 <= at) {
            let Some(claim) = claims.get(*index) else { break };
            let entry = (claim.rank, claim.from_ms, *index);
            if *begins {
                active.insert(entry);
            } else {
                active.remove(&entry);
            }
            next += 1;
        }
        let until = edges.get(next).map_or(length_ms, |edge| edge.0);
        let counts = active.first().and_then(|(_, _, index)| claims.get(*index));
        let class = counts.map_or_else(|| Class::new(Group::Unexplained, "no record"), |claim| claim.class.clone());
        match pieces.last_mut() {
            Some(last) if last.class == class => last.to_ms = until,
            _ => pieces.push(Piece { from_ms: at, to_ms: until, class }),
        }
        at = until;
    }
    pieces
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    const RANKS: [Rank; 8] = [
        Rank::Light,
        Rank::WorkInDaylight,
        Rank::Daytime,
        Rank::Verdict,
        Rank::Fault,
        Rank::Timed,
        Rank::Step,
        Rank::Idle,
    ];

    fn claims() -> impl Strategy<Value = Vec<Claim>> {
        let one = (-50_i64..250, -50_i64..250, 0_usize..8, 0_usize..3).prop_map(|(from_ms, to_ms, rank, kind)| Claim {
            from_ms,
            to_ms,
            rank: RANKS[rank],
            class: Class::new(Group::ALL[rank.min(6)], ["a", "b", "c"][kind]),
        });
        proptest::collection::vec(one, 0..40)
    }

    proptest! {
        #[test]
        fn the_classes_cover_the_span_exactly_once_whatever_is_claimed(length_ms in 0_i64..200, claims in claims()) {
            let pieces = divide(length_ms, &claims);
            let mut at = 0;
            for piece in &pieces {
                prop_assert_eq!(piece.from_ms, at);
                prop_assert!(piece.to_ms > piece.from_ms);
                at = piece.to_ms;
            }
            prop_assert_eq!(at, length_ms);
            // Each ms has the class of the smallest rank that claims it.
            for piece in &pieces {
                for ms in piece.from_ms..piece.to_ms {
                    let claimed = |claim: &&Claim| claim.from_ms <= ms && ms < claim.to_ms;
                    match claims.iter().filter(claimed).map(|claim| claim.rank).min() {
                        None => prop_assert_eq!(piece.class.group, Group::Unexplained),
                        Some(least) => prop_assert!(claims
                            .iter()
                            .filter(claimed)
                            .any(|claim| claim.rank == least && claim.class == piece.class)),
                    }
                }
            }
        }
    }
}
