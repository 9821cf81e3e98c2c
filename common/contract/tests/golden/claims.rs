//! Every payload type with the way it travels: in the envelope, or plain in a query.

use contract::device::{
    Description, camera, cover_calibrator, dome, filter_wheel, focuser, observing_conditions, record, rotator,
    safety_monitor, switch, telescope,
};
use contract::{Command, DeviceKind, DeviceState, Kind, Order, Payload, Reply, Stamped};
use contract::{archive, audit, node, observatory};
use serde_json::Value;

/// A payload type: its name, and its decoder followed by its encoder.
pub struct Claim {
    pub name: &'static str,
    pub again: fn(&[u8]) -> Result<Value, serde_json::Error>,
}

fn again<T: serde::Serialize + serde::de::DeserializeOwned>(bytes: &[u8]) -> Result<Value, serde_json::Error> {
    serde_json::from_slice::<T>(bytes).and_then(serde_json::to_value)
}

fn stamped<T: Payload>() -> Claim {
    Claim { name: T::NAME, again: again::<Stamped<T>> }
}

fn plain<T: Payload>() -> Claim {
    Claim { name: T::NAME, again: again::<T> }
}

fn device<K: DeviceKind>() -> Vec<Claim> {
    vec![stamped::<Description<K::Capabilities>>(), stamped::<DeviceState<K::Fields>>(), plain::<Command<K::Command>>()]
}

/// All of them.
pub fn claims() -> Vec<Claim> {
    let mut all = vec![
        stamped::<camera::Frame>(),
        stamped::<dome::Guard>(),
        stamped::<observatory::SafetyState>(),
        stamped::<observatory::Lease>(),
        stamped::<observatory::NightState>(),
        stamped::<observatory::ScheduleState>(),
        stamped::<observatory::Alerts>(),
        stamped::<observatory::PointingState>(),
        stamped::<observatory::GuidingState>(),
        stamped::<observatory::GuideReference>(),
        stamped::<observatory::FocusState>(),
        stamped::<observatory::FocusRun>(),
        stamped::<observatory::FocusLearnt>(),
        stamped::<observatory::StandingOrders>(),
        stamped::<observatory::OpticsState>(),
        stamped::<observatory::Permit>(),
        stamped::<observatory::FrameFacts>(),
        stamped::<observatory::Correction>(),
        stamped::<archive::Stored>(),
        stamped::<node::NodeState>(),
        stamped::<node::DiaryLine>(),
        stamped::<audit::Said<audit::Record>>(),
        plain::<audit::Question>(),
        plain::<audit::Answer<audit::Record>>(),
        plain::<record::Question>(),
        plain::<record::Record<observing_conditions::Fields>>(),
        plain::<record::Record<switch::Fields>>(),
        plain::<Reply>(),
        plain::<Order>(),
        plain::<observatory::ActionQuestion>(),
        plain::<observatory::ActionAnswer>(),
        plain::<observatory::ScheduleDraft>(),
        plain::<observatory::ScheduleFindings>(),
        plain::<archive::Question>(),
        plain::<archive::Answer>(),
    ];
    for kind in Kind::ALL {
        all.extend(match kind {
            Kind::Telescope => device::<telescope::Telescope>(),
            Kind::Camera => device::<camera::Camera>(),
            Kind::FilterWheel => device::<filter_wheel::FilterWheel>(),
            Kind::Focuser => device::<focuser::Focuser>(),
            Kind::Dome => device::<dome::Dome>(),
            Kind::SafetyMonitor => device::<safety_monitor::SafetyMonitor>(),
            Kind::ObservingConditions => device::<observing_conditions::ObservingConditions>(),
            Kind::CoverCalibrator => device::<cover_calibrator::CoverCalibrator>(),
            Kind::Switch => device::<switch::Switch>(),
            Kind::Rotator => device::<rotator::Rotator>(),
        });
    }
    all
}
