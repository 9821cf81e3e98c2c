//! The fake dome's device node: its guard, its shutter, and the lease that it grants.

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use bus::{Bus, Clock, Latest, Service};
use contract::device::dome::{self, Dome, Guard, GuardAction, Shutter};
use contract::observatory::{Lease, Permit, Verdict};
use contract::{Address, BootId, Command, Datum, Key, Part, Reason, Refusal, Reply};

use super::{Device, accept, serve};

/// A holder that was silent for so long is dead; the real one waits 5 s.
const SILENT: Duration = Duration::from_secs(5);

/// What a test turns at the dome.
pub struct Keeper {
    pub hold: Arc<AtomicBool>,
    pub lease_held: Arc<AtomicBool>,
    pub clock: Clock,
    pub turn_deg_per_s: Arc<Mutex<Option<f64>>>,
}

/// The lease: one incarnation holds it, until it is silent or has released it.
struct Arbiter {
    token: Arc<AtomicU64>,
    holder: Mutex<Option<BootId>>,
    permit: Latest<Permit>,
    lease: Latest<Lease>,
}

impl Arbiter {
    fn claim(&self, boot_id: BootId) -> Result<u64, String> {
        let mut holder = self.holder.lock().unwrap();
        let is_released = self.lease.get().is_some_and(|received| received.sample.body.holder.is_empty());
        let speaks =
            self.permit.fresh(SILENT).is_some_and(|received| Some(&received.sample.boot_id) == holder.as_ref());
        if holder.as_ref().is_some_and(|holder| *holder != boot_id) && speaks && !is_released {
            return Err("another incarnation holds the lease".to_owned());
        }
        *holder = Some(boot_id);
        Ok(self.token.fetch_add(1, Ordering::SeqCst) + 1)
    }
}

impl Keeper {
    /// Takes the dome's commands, and publishes the guard's numbers.
    pub async fn serve(self, bus: &Bus, dome: &Arc<Device<Dome>>, address: &Address) -> Service {
        let permit: Latest<Permit> = bus.latest(&Key::Permit(address.clone(), dome.key.name.clone())).await.unwrap();
        let lease = bus.latest(&Key::Observatory(address.clone(), Part::Lease)).await.unwrap();
        let guard = bus.publisher::<Guard>(&Key::Guard(dome.key.clone())).await.unwrap();
        let (numbers, tokens) = (Arc::new(AtomicU64::new(0)), Arc::new(AtomicU64::new(0)));
        let Self { hold, lease_held, clock, turn_deg_per_s } = self;
        let (counter, token, held, shutter) = (numbers.clone(), tokens.clone(), hold.clone(), dome.clone());
        tokio::spawn(async move {
            loop {
                let number = counter.fetch_add(1, Ordering::Relaxed);
                let is_closed = shutter.state.borrow().fields.shutter == Datum::Known(Shutter::Closed);
                let body = Guard {
                    number,
                    token: token.load(Ordering::SeqCst),
                    permit_valid_s: 10.0,
                    permits: vec![],
                    may_be_open: true,
                    action: GuardAction::Watching,
                    hold: held.load(Ordering::Relaxed),
                    dropped: 0,
                    // This shutter never lies: its reports are proven.
                    verified_closed: Some(is_closed),
                    waits_for_mounts: None,
                    watchdog_s: None,
                    granted: vec![],
                };
                guard.put(body).await.unwrap();
                tokio::time::sleep(Duration::from_millis(300)).await;
            }
        });
        let arbiter = Arbiter { token: tokens.clone(), holder: Mutex::default(), permit: permit.clone(), lease };
        let at = dome.clone();
        let newest = move || tokens.load(Ordering::SeqCst);
        serve(bus, &dome.key, move |command: Command<dome::Command>| match command.action {
            dome::Command::Claim if lease_held.load(Ordering::Relaxed) => {
                refuse(&command, Reason::LeaseHeld, "observatory/other is alive")
            }
            dome::Command::Claim => match arbiter.claim(command.boot_id.clone().unwrap()) {
                Ok(token) => accept(command.id, Some(token)),
                Err(why) => refuse(&command, Reason::LeaseHeld, &why),
            },
            dome::Command::Resume => {
                hold.store(false, Ordering::Relaxed);
                at.take(command, Duration::ZERO, |_| {}, |_| {})
            }
            dome::Command::OpenShutter => {
                let number = numbers.load(Ordering::Relaxed);
                let valid = permit.fresh(Duration::from_secs(3)).is_some_and(|received| {
                    let permit = received.sample.body;
                    permit.verdict == Verdict::Safe && permit.token == newest() && permit.guard_number + 10 > number
                });
                if valid && command.token == Some(newest()) && !hold.load(Ordering::Relaxed) {
                    let end = |fields: &mut dome::Fields| fields.shutter = Datum::Known(Shutter::Open);
                    let start = |fields: &mut dome::Fields| fields.shutter = Datum::Known(Shutter::Opening);
                    at.take(command, Duration::from_millis(100), start, end)
                } else {
                    refuse(&command, Reason::NoPermit, "no permit")
                }
            }
            dome::Command::CloseShutter => {
                let end = |fields: &mut dome::Fields| fields.shutter = Datum::Known(Shutter::Closed);
                let start = |fields: &mut dome::Fields| fields.shutter = Datum::Known(Shutter::Closing);
                at.take(command, Duration::from_millis(100), start, end)
            }
            dome::Command::SlewToAzimuth { azimuth_deg } => {
                assert_eq!(command.token, Some(newest()), "turning needs the token");
                let from_deg = at.state.borrow().fields.azimuth_deg.known().copied().unwrap_or_default();
                let way_deg = units::Angle::from_degrees(azimuth_deg - from_deg).wrapped_signed().abs().degrees();
                let takes = match *turn_deg_per_s.lock().unwrap() {
                    Some(speed) if speed > 0.0 => clock.machine_duration(Duration::from_secs_f64(way_deg / speed)),
                    _ => Duration::from_secs(3600),
                };
                let start = |fields: &mut dome::Fields| fields.slewing = Datum::Known(true);
                at.take(command, takes, start, move |fields| {
                    (fields.azimuth_deg, fields.slewing) = (Datum::Known(azimuth_deg), Datum::Known(false));
                })
            }
            dome::Command::Slave { on } => {
                at.take(command, Duration::from_millis(20), |_| {}, move |fields| fields.slaved = Datum::Known(on))
            }
            _ => at.take(command, Duration::ZERO, |_| {}, |_| {}),
        })
        .await
    }
}

fn refuse(command: &Command<dome::Command>, reason: Reason, detail: &str) -> Reply {
    Reply::Refusal(Refusal { id: command.id.clone(), reason, detail: detail.to_owned() })
}
