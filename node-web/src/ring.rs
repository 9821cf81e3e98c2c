//! The last things that happened, in their order, each with a number that grows.

use std::collections::VecDeque;

/// A ring of numbered things.
#[derive(Debug)]
pub struct Ring<T> {
    things: VecDeque<(u64, T)>,
    most: usize,
}

impl<T> Ring<T> {
    /// One that remembers so many.
    pub fn of(most: usize) -> Self {
        Self { things: VecDeque::new(), most }
    }

    /// Takes the next thing, with a greater number than those before; returns the oldest one, which gives way to it.
    pub fn push(&mut self, number: u64, thing: T) -> Option<(u64, T)> {
        let oldest = if self.things.len() >= self.most { self.things.pop_front() } else { None };
        self.things.push_back((number, thing));
        oldest
    }

    /// Things after a number, oldest first.
    pub fn after(&self, number: u64) -> impl Iterator<Item = (u64, &T)> {
        let first = self.things.partition_point(|(at, _)| *at <= number);
        self.things.range(first..).map(|(number, thing)| (*number, thing))
    }
}
