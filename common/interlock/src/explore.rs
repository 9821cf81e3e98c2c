//! Visits every state that a few messages can lead to, in any order.

use std::collections::HashSet;
use std::hash::Hash;

/// Visits the states within `depth` steps of `start`, breadth first, and returns how many there are. `next` names the
/// steps from a state, and asserts what must hold after each; it gets the way to the state for its messages.
pub fn explore<S: Clone + Eq + Hash>(
    start: S,
    depth: usize,
    next: impl Fn(&S, &[&'static str]) -> Vec<(&'static str, S)>,
) -> usize {
    let mut known = HashSet::from([start.clone()]);
    let mut front = vec![(start, Vec::new())];
    for _ in 0..depth {
        let mut reached = Vec::new();
        for (state, way) in &front {
            for (step, after) in next(state, way) {
                if known.insert(after.clone()) {
                    reached.push((after, way.iter().copied().chain([step]).collect::<Vec<_>>()));
                }
            }
        }
        front = reached;
    }
    known.len()
}
