//! Where the mounts pointed lately: a frame is solved after its exposure, when the mount may be on its way elsewhere.

use std::collections::{BTreeMap, VecDeque};
use std::sync::{Arc, Mutex, PoisonError};

use contract::device::telescope::Fields;
use contract::{DeviceState, Link, Name};
use tokio::task::JoinSet;
use units::Utc;

use super::FrameData;
use crate::devices::Devices;

/// States kept of each mount: an hour at one a second.
const MOST_STORED: usize = 3600;
/// A state further away in time does not count for an instant, sky s at speed 1.
const NEAR_S: f64 = 30.0;

/// The recent states of the telescope's mounts.
#[derive(Debug, Default)]
pub struct Mounts {
    lately: Mutex<BTreeMap<Name, VecDeque<(Utc, Fields)>>>,
}

impl Mounts {
    /// Adds the state of a mount at an instant.
    pub fn note(&self, mount: &Name, at: Utc, fields: Fields) {
        let mut lately = self.lately.lock().unwrap_or_else(PoisonError::into_inner);
        let states = lately.entry(mount.clone()).or_default();
        if states.back().is_some_and(|(last, _)| at < *last) {
            // The clock was set back: earlier states cannot be placed any more.
            states.clear();
        }
        states.push_back((at, fields));
        if states.len() > MOST_STORED {
            states.pop_front();
        }
    }

    /// The state of a mount nearest to an instant, if that is near; sky time runs `speed` times as fast as polls.
    pub fn at(&self, mount: &Name, at: Utc, speed: f64) -> Option<Fields> {
        let lately = self.lately.lock().unwrap_or_else(PoisonError::into_inner);
        let states = lately.get(mount)?;
        let after = states.partition_point(|(at_utc, _)| *at_utc < at);
        let near = [after.checked_sub(1), Some(after)].into_iter().flatten().filter_map(|n| states.get(n));
        let distance_s = |at_utc: &Utc| at_utc.seconds_since(at).abs();
        let (at_utc, fields) = near.min_by(|a, b| distance_s(&a.0).total_cmp(&distance_s(&b.0)))?;
        (distance_s(at_utc) <= NEAR_S * speed.max(1.0)).then(|| fields.clone())
    }
}

/// Collects the mounts' states until the node ends.
pub async fn keep_noting(devices: Arc<Devices>, frames: Arc<FrameData>) -> anyhow::Result<()> {
    let mut followers = JoinSet::new();
    for mount in &devices.mounts {
        let (mut states, name, frames) =
            (mount.instrument.follow(), mount.instrument.device.name.clone(), frames.clone());
        followers.spawn(async move {
            loop {
                states.changed().await;
                let Some(received) = states.get() else { continue };
                let DeviceState { link, fields, .. } = received.sample.body;
                if link == Link::Connected {
                    frames.mounts.note(&name, received.sample.at_utc, fields);
                }
            }
        });
    }
    while followers.join_next().await.transpose()?.is_some() {}
    // A telescope without a mount has nothing to note.
    std::future::pending().await
}

#[cfg(test)]
mod tests {
    use contract::Datum;

    use super::*;

    fn pointing(ra_deg: f64) -> Fields {
        Fields { ra_deg: Datum::Known(ra_deg), ..Fields::default() }
    }

    #[test]
    fn the_nearest_word_of_an_instant_counts_and_none_that_is_far() {
        let (mounts, name, at) = (Mounts::default(), "mount".parse().unwrap(), |s| Utc::from_seconds(1.8e9 + s));
        for second in 0..100 {
            mounts.note(&name, at(f64::from(second)), pointing(f64::from(second)));
        }
        let ra = |s, speed| mounts.at(&name, at(s), speed).and_then(|fields| fields.ra_deg.known().copied());
        assert_eq!(
            [ra(-40.0, 1.0), ra(-3.0, 1.0), ra(41.4, 1.0), ra(41.6, 1.0)],
            [None, Some(0.0), Some(41.0), Some(42.0)]
        );
        assert_eq!([ra(128.0, 1.0), ra(140.0, 1.0), ra(140.0, 10.0)], [Some(99.0), None, Some(99.0)]);
        mounts.note(&name, at(50.0), pointing(7.0));
        assert_eq!(ra(60.0, 1.0), Some(7.0), "a clock that was put back");
        assert_eq!(mounts.at(&"other".parse().unwrap(), at(0.0), 1.0), None);
    }
}
