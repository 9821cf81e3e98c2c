//! Flat fields: of the twilight sky, and of a panel.
//!
//! ```text
//!   sky:   wait for the Sun's window -> open, point away from the Sun ---+
//!   panel: close the cover, light it -------------------------------------+--> which filter next? (order)
//!                                                                               |
//!      too dark or too bright, and it gets no better: the filter is given up <--+--> sound: a small frame aside
//!      ... and it will get better: wait                                         |      shows how bright it is
//!                                                                               v
//!                              kept and not counted <-- out of tolerance -- take a frame, learn from its level
//! ```
//! `schedule::flats` does the pure computation. [`run`] takes frames and judges them; [`sky`] and [`panel`] hold the
//! steps of the two methods. Each level is one that [`crate::frames`] measures for every frame anyway. Decision 0028.

pub mod panel;
pub mod run;
pub mod sky;
