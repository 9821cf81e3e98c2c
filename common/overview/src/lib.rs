//! One telescope in a few words, by what any of its nodes publishes: the command line and the page show the same.
//!
//! The observatory node reports posture, verdict and activity. Where it is silent, the device nodes of the domes still
//! publish: [`DomeView`] has the posture by shutter and guard, since when no permit was renewed, and what closes the
//! dome by itself. [`Seen::now`] is the text "Now": the present cause, whoever reports it.
//!
//! Values in, values out: no bus, no clock.
//!
//! # Invariants
//!
//! - A dome is closed only where its guard does not doubt it: `a_shutter_is_closed_only_with_the_word_of_its_guard`.

mod dome_view;
mod seen;

pub use dome_view::{DomeView, PublishedGuard};
pub use seen::{Seen, length, silent};
