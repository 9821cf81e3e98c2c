//! The world: one observatory under one clock, with its faults and its log, shared by all who look at it.

use std::collections::HashMap;
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use serde_json::{Value, json};
use sky::{Icrs, SkyError};
use units::Utc;

use crate::answer::{Answer, Refusal};
use crate::clock::SkyClock;
use crate::common;
use crate::exposure::Plan;
use crate::faults::{Fault, InForce};
use crate::frame::Frame;
use crate::kind::Kind;
use crate::log::{Entry, Log};
use crate::observatory::Observatory;
use crate::options::Options;
use crate::render::render;
use crate::request::Request;
use crate::telescope;
use crate::weather::Quantity;

/// A simulated observatory that runs by itself.
#[derive(Debug)]
pub struct World {
    name: String,
    clock: SkyClock,
    inner: Mutex<Inner>,
    transactions: AtomicU32,
}

#[derive(Debug)]
struct Inner {
    observatory: Observatory,
    connected: HashMap<Kind, bool>,
    faults: HashMap<Kind, InForce>,
    log: Log,
}

/// What a device answers after its faults have had their say.
#[derive(Debug)]
pub struct Reply {
    /// The answer itself.
    pub answer: Answer,
    /// The fault in force, as far as it concerns how the answer is told.
    pub fault: Fault,
    /// Number of the PUT in the log.
    pub logged: Option<u64>,
}

impl World {
    /// The observatory of these options, whose clock starts now.
    ///
    /// # Errors
    /// When the site or the start is nowhere the sky can be computed for.
    pub fn new(options: &Options) -> Result<Self, SkyError> {
        let inner = Inner {
            observatory: Observatory::new(options)?,
            connected: HashMap::new(),
            faults: HashMap::new(),
            log: Log::default(),
        };
        Ok(Self {
            name: options.name.clone(),
            clock: SkyClock::at(options.start, options.speed),
            inner: Mutex::new(inner),
            transactions: AtomicU32::new(0),
        })
    }

    /// The default observatory at another time and speed.
    ///
    /// # Errors
    /// When the start is a time the sky cannot be computed for.
    pub fn at(start: Utc, speed: f64) -> Result<Self, SkyError> {
        Self::new(&Options { start, speed, ..Options::default() })
    }

    /// What the server calls itself.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// The world's clock.
    pub fn clock(&self) -> &SkyClock {
        &self.clock
    }

    /// Sky time.
    pub fn now(&self) -> Utc {
        self.clock.now()
    }

    /// The next server transaction number.
    pub fn next_transaction(&self) -> u32 {
        self.transactions.fetch_add(1, Ordering::Relaxed).wrapping_add(1)
    }

    fn lock(&self) -> MutexGuard<'_, Inner> {
        let mut inner = self.inner.lock().unwrap_or_else(PoisonError::into_inner);
        inner.observatory.advance(self.clock.now());
        inner
    }

    /// Lets time pass; draws in the background whatever frame has been exposed. Needs a tokio runtime.
    pub fn advance(self: &Arc<Self>) {
        let plan = self.lock().observatory.camera.take_plan();
        if let Some(plan) = plan {
            let world = self.clone();
            tokio::task::spawn_blocking(move || world.develop(&plan));
        }
    }

    fn develop(&self, plan: &Plan) {
        let frame = render(plan);
        self.lock().observatory.camera.develop(frame);
    }

    /// Asks a device, faults included.
    pub fn ask(&self, kind: Kind, request: &Request) -> Reply {
        let now = self.clock.now();
        let mut guard = self.lock();
        let inner = &mut *guard;
        inner.log.count(kind);
        let logged = request.is_put.then(|| inner.log.note(kind, &request.member, request.told(), now));
        let in_force = inner.faults.get(&kind).filter(|it| it.fault.concerns(&request.member));
        let fault = in_force.map(|it| it.fault.clone()).unwrap_or_default();
        // a device that hangs, drops the line or shows an error page does not do what it was told
        let answer = if fault.hang || fault.refuse || fault.html {
            Err(Refusal::asked_for(0x500))
        } else if let Some(code) = fault.error {
            Err(Refusal::asked_for(code))
        } else {
            let connected = inner.connected.entry(kind).or_insert(false);
            common::ask(&mut inner.observatory, connected, kind, request)
        };
        let answer = match inner.faults.get_mut(&kind) {
            Some(it) if fault.stale && !request.is_put => {
                it.frozen(format!("{}?{}", request.member, request.told()), answer)
            }
            _ => answer,
        };
        if let Some(seq) = logged.filter(|_| !(fault.hang || fault.refuse)) {
            inner.log.answered(seq, error_number(&answer));
        }
        Reply { answer, fault, logged }
    }

    /// The camera's finished frame.
    ///
    /// # Errors
    /// When there is none, or the camera is not connected.
    pub fn image(&self) -> Result<Arc<Frame>, Refusal> {
        let inner = self.lock();
        if !inner.connected.get(&Kind::Camera).copied().unwrap_or(false) {
            return Err(Refusal::not_connected());
        }
        inner.observatory.camera.image(self.clock.now())
    }

    /// Sky time at which the exposure under way ends.
    pub fn exposure_ends(&self) -> Option<Utc> {
        self.lock().observatory.camera.ends()
    }

    /// Whether the mount still moves.
    pub fn is_slewing(&self) -> bool {
        self.lock().observatory.telescope.mount.is_slewing()
    }

    /// Starts or ends the rain.
    pub fn rain(&self, raining: bool) {
        self.lock().observatory.weather.rain(raining);
        self.refresh();
    }

    /// Orders a weather value in ASCOM's unit; None lets nature have its way again.
    pub fn set_weather(&self, quantity: Quantity, value: Option<f64>) {
        self.lock().observatory.weather.order(quantity, value);
        self.refresh();
    }

    /// Makes the safety monitor say unsafe, or speak for the weather again.
    pub fn set_unsafe(&self, is_unsafe: bool) {
        self.lock().observatory.safety_monitor.ordered_unsafe = is_unsafe;
    }

    /// Cuts or restores the mains of the UPS.
    pub fn set_on_mains(&self, on_mains: bool) {
        self.lock().observatory.switch.set_on_mains(on_mains);
    }

    /// Makes the shutter stick half-way, or run freely again (when next told to move).
    pub fn stick_shutter_half_open(&self, sticks: bool) {
        self.lock().observatory.dome.sticks_half_open = sticks;
    }

    /// Turns the dome at this speed from now on, deg per sky second: at 0 it hangs; None: as at the start.
    pub fn set_turn_speed(&self, deg_per_s: Option<f64>) {
        self.lock().observatory.dome.set_turn_speed(deg_per_s);
    }

    /// Makes the mount say that it is parked, and believe it, or tell the truth again.
    pub fn lie_about_park(&self, lies: bool) {
        self.lock().observatory.telescope.lies_about_park = lies;
    }

    /// Makes the mount stay on its side of the pier whatever it is told, or flip again.
    pub fn ignore_flips(&self, ignores: bool) {
        self.lock().observatory.telescope.mount.ignores_flip = ignores;
    }

    /// Lets the dome close itself when no PUT came for so many machine seconds; None: not at all.
    pub fn set_watchdog(&self, limit_s: Option<f64>) {
        let mut inner = self.lock();
        inner.observatory.dome.watchdog_s = limit_s;
        inner.observatory.dome.feed();
    }

    /// How often the dome's watchdog has closed it.
    pub fn watchdog_closings(&self) -> u32 {
        self.lock().observatory.dome.watchdog_closings
    }

    /// Fraction of the slit that is open, whatever the dome says.
    pub fn dome_open(&self) -> f64 {
        self.lock().observatory.dome.open()
    }

    /// Where the telescope really looks.
    pub fn looks_at(&self) -> Icrs {
        self.lock().observatory.scene().pointing.icrs
    }

    /// Whether the mount really is parked, whatever it says.
    pub fn is_parked(&self) -> bool {
        self.lock().observatory.telescope.mount.parked
    }

    /// Spoils a device's answers; [`Fault::default`] heals it.
    pub fn fault(&self, kind: Kind, fault: Fault) {
        let mut guard = self.lock();
        let inner = &mut *guard;
        let mut frozen = HashMap::new();
        if fault.stale {
            let connected = inner.connected.entry(kind).or_insert(false);
            let common = ["connected", "devicestate"].into_iter().map(str::to_owned);
            let own = Observatory::properties(kind).iter().map(|name| name.to_ascii_lowercase());
            for member in own.chain(common) {
                let request = Request::new(false, &member, "");
                let answer = common::ask(&mut inner.observatory, connected, kind, &request);
                frozen.insert(format!("{member}?"), answer);
            }
        }
        inner.faults.insert(kind, InForce::new(fault, frozen));
    }

    /// The faults in force.
    pub fn faults(&self) -> HashMap<Kind, Fault> {
        let inner = self.lock();
        let all = inner.faults.iter().filter(|(_, it)| it.fault != Fault::default());
        all.map(|(kind, it)| (*kind, it.fault.clone())).collect()
    }

    /// The device falls off its cable: not connected until somebody connects it again.
    pub fn lose_connection(&self, kind: Kind) {
        self.lock().connected.insert(kind, false);
    }

    /// Fair weather, honest devices, no faults; what moved stays where it is.
    pub fn clear_faults(&self) {
        let mut inner = self.lock();
        inner.faults.clear();
        inner.observatory.weather.clear();
        inner.observatory.safety_monitor.ordered_unsafe = false;
        inner.observatory.dome.sticks_half_open = false;
        inner.observatory.dome.set_turn_speed(None);
        inner.observatory.telescope.lies_about_park = false;
        inner.observatory.telescope.mount.ignores_flip = false;
        inner.observatory.switch.set_on_mains(true);
        drop(inner);
        self.refresh();
    }

    /// Every PUT with a number above `seq` (0: all), oldest first.
    pub fn puts_since(&self, seq: u64) -> Vec<Entry> {
        self.lock().log.since(seq)
    }

    /// Requests to devices within the last minute of machine time.
    pub fn requests_last_minute(&self) -> usize {
        self.lock().log.last_minute()
    }

    /// Number and shares of all requests since the start.
    pub fn request_counts(&self) -> Value {
        let inner = self.lock();
        json!({
            "total": inner.log.total(),
            "last_minute": inner.log.last_minute(),
            "by_device": inner.log.by_device(),
        })
    }

    /// The truth about everything, as JSON.
    pub fn told(&self) -> Value {
        let inner = self.lock();
        let observatory = &inner.observatory;
        let scene = observatory.scene();
        json!({
            "utc": scene.now,
            "sun_altitude_deg": observatory.sun().altitude.degrees(),
            "weather": observatory.conditions.told(),
            "safe": observatory.safety_monitor.is_safe(&observatory.conditions),
            "telescope": telescope::told(&observatory.telescope, &scene),
            "camera": {
                "position_angle_deg": scene.light.position_angle.degrees(),
                "defocus_steps": scene.light.defocus_steps,
                "aperture_open": scene.light.open,
            },
            "dome": observatory.dome.told(scene.light.slit_free),
            "ups": observatory.switch.told(),
        })
    }

    /// Lets changed weather take effect at once, not at the next advance of the clock.
    fn refresh(&self) {
        let mut inner = self.lock();
        inner.observatory.feel_weather();
    }
}

/// ASCOM's number of an answer; 0 for success.
pub fn error_number(answer: &Answer) -> i32 {
    match answer {
        Ok(_) => 0,
        Err(Refusal::Ascom { code, .. }) => *code,
        Err(Refusal::BadRequest(_) | Refusal::UnknownMember) => 400,
    }
}
