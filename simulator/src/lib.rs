//! A whole simulated observatory: an Alpaca server with a sky, a world and faults.
//!
//! One [`World`] has one clock, and everything physical in it happens in that clock's sky time: the Sun sinks, the
//! weather changes, the mount slews and drifts, the shutter travels, the cooler cools. At speed 60 a minute of night
//! takes a second of machine time. Ten devices, one of each ASCOM kind, and an optional guide camera serve that world
//! through the Alpaca protocol ([`alpaca`]); each has a file of its name. A device is a plain struct: `get` and `put`
//! implement the members of ASCOM, `advance` lets sky time pass, and a [`scene::Scene`] shows it the rest of the
//! observatory.
//!
//! The stars are real. The camera sees the catalogue that Starmesh ships, where the mount truly points (which differs a
//! little from what it reports), through filter, focus, seeing and clouds; so the same right ascension and declination
//! always show the same stars, and solving, guiding and focusing work on it as on the real sky. Faint stars for narrow
//! fields come from a seeded sky ([`faint`]) that can be written out as a catalogue. A star can dim for some time, as in a
//! transit ([`Transit`]).
//!
//! Faults happen on request: through methods of [`World`] in tests, through HTTP ([`control`]) from anywhere.
//!
//! ```no_run
//! # async fn night() -> Result<(), simulator::SimulatorError> {
//! let simulator = simulator::Simulator::start(simulator::Options { speed: 60.0, ..Default::default() }).await?;
//! println!("Alpaca at http://{}/", simulator.address());
//! simulator.world().rain(true);
//! simulator.stop().await;
//! # Ok(())
//! # }
//! ```

pub mod alpaca;
mod answer;
mod camera;
pub mod catalogue;
mod chance;
mod clock;
mod common;
mod connection;
pub mod control;
mod cover_calibrator;
mod discovery;
mod dome;
pub mod exposure;
pub mod faint;
mod faults;
mod filter_wheel;
mod focuser;
mod frame;
mod gear;
mod guide_camera;
mod kind;
mod log;
mod management;
mod mount;
mod observatory;
mod observing_conditions;
mod options;
pub mod render;
mod request;
mod rotator;
mod safety_monitor;
pub mod scene;
mod server;
pub mod site;
mod slit;
mod switch;
mod telescope;
mod transit;
mod travel;
mod vendor;
mod weather;
mod world;

pub use clock::SkyClock;
pub use faults::Fault;
pub use frame::Frame;
pub use kind::Kind;
pub use log::Entry;
pub use options::{
    CameraOptions, DomeOptions, Filter, FocusOptions, GuideCameraOptions, MountOptions, Options, SlitOptions,
};
pub use server::{Simulator, SimulatorError, run};
pub use transit::Transit;
pub use vendor::Vendor;
pub use weather::{Conditions, Quantity};
pub use world::World;
