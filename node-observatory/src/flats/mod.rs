//! Flat fields: of the twilight sky, and of a panel.
//!
//! ```text
//!   sky:   wait for the Sun's window -> open, point away from the Sun ---+
//!   panel: close the cover, light it -------------------------------------+--> which filter next? (order)
//!                                                                               |
//!      too dark or too bright, and it gets no better: the filter is given up <--+--> sound: a small frame aside
//!      ... and it will get better: wait                                         |      tells how bright it is
//!                                                                               v
//!                              kept and not counted <-- out of tolerance -- take a frame, learn from its level
//! ```
//! What is computed is pure: `schedule::flats`. [`run`]
//! takes frames and judges them, [`sky`] and [`panel`] tell the two stories. Levels are what every frame is measured for
//! anyway ([`crate::frames`]). Decision 0028.

pub mod panel;
pub mod run;
pub mod sky;
