//! The permit of each enclosure: renewed every second, so that silence closes.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use bus::Publisher;
use contract::device::dome::Guard;
use contract::observatory::{Permit, Verdict};
use contract::{BootId, Key};

use crate::authority::Authority;
use crate::devices::Devices;
use crate::devices::dome::Dome;
use crate::devices::guards::Guards;

/// A guard publishes a number each second, and the permit that answers it is as young as it can be. While no guard is
/// received, permits go out all the same.
const PERIOD: Duration = Duration::from_millis(1200);

/// Renews every permit when its guard's number arrives and at each change of the verdict, while this node commands.
pub async fn keep_renewing(
    authority: Arc<Authority>,
    devices: Arc<Devices>,
    leaves_alone: Arc<AtomicBool>,
) -> anyhow::Result<()> {
    let mut lines: Vec<(&Dome, Publisher<Permit>)> = Vec::new();
    for dome in &devices.domes {
        let key = Key::Permit(authority.node.config.address(), dome.instrument.device.name.clone());
        lines.push((dome, authority.node.bus.publisher(&key).await?));
    }
    let mut guards: Vec<_> = devices.domes.iter().map(|dome| dome.guards.clone()).collect();
    let (mut current_verdict, mut hold) = (authority.verdict.clone(), authority.hold.clone());
    loop {
        let current = verdict(&authority, &leaves_alone);
        for (dome, line) in &lines {
            for permit in permits(&authority, dome, current) {
                if let Err(error) = line.put(permit).await {
                    tracing::warn!(%error, dome = %dome.instrument.device.name, "a permit was not sent");
                }
            }
        }
        let changed = async {
            while verdict(&authority, &leaves_alone) == current {
                tokio::select! {
                    _ = current_verdict.changed() => {}
                    _ = hold.changed() => return,
                    () = recv_any(&mut guards) => return,
                }
            }
        };
        let _ = tokio::time::timeout(PERIOD, changed).await;
    }
}

/// Waits for the next number of any guard.
async fn recv_any(guards: &mut [Guards]) {
    if guards.is_empty() {
        std::future::pending::<()>().await;
    }
    futures_util::future::select_all(guards.iter_mut().map(|guard| Box::pin(guard.changed()))).await;
}

fn verdict(authority: &Authority, leaves_alone: &AtomicBool) -> Verdict {
    let leaves = leaves_alone.load(Ordering::Relaxed);
    if authority.is_safe() && !leaves { Verdict::Safe } else { Verdict::Unsafe }
}

/// A permit needs a lease, a guard's number to answer to, and a verdict that was formed on received inputs. Every node
/// that publishes in a guard's name is answered, each with its own number, so that a stranger takes nothing from the
/// real one.
fn permits(authority: &Authority, dome: &Dome, verdict: Verdict) -> Vec<Permit> {
    let Some(token) = authority.hold.borrow().token().filter(|_| authority.verdict.borrow().settled) else {
        return Vec::new();
    };
    let mut guards = dome.guards.living(authority.node.bus.clock().machine());
    if guards.is_empty() {
        guards.extend(dome.guard.get().map(|received| (received.sample.boot_id, received.sample.body)));
    }
    let permit = |(guard_boot_id, guard): (BootId, Guard)| Permit {
        verdict,
        commander: authority.node.signature(),
        token,
        guard_number: guard.number,
        guard_boot_id,
    };
    guards.into_iter().map(permit).collect()
}
