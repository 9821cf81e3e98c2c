//! The classes of the seconds of a night.

use serde::Serialize;

/// What a second was used for, or lost to. Where several fit, the first of this list counts.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Group {
    /// A frame of the schedule collected light of the sky.
    OpenShutter,
    /// Before sunset or after sunrise, and no action was under way.
    Daytime,
    /// The verdict was unsafe, or exposing was suspended.
    Weather,
    /// A device or a node did not work.
    Fault,
    /// An action did something else than collecting light.
    Overhead,
    /// There was nothing to do, or nothing was allowed.
    Idle,
    /// Nothing that was recorded explains it.
    Unexplained,
}

impl Group {
    /// All of them.
    pub const ALL: [Self; 7] =
        [Self::OpenShutter, Self::Daytime, Self::Weather, Self::Fault, Self::Overhead, Self::Idle, Self::Unexplained];

    /// The words of the page.
    pub const fn words(self) -> &'static str {
        match self {
            Self::OpenShutter => "open shutter",
            Self::Daytime => "daytime",
            Self::Weather => "weather and safety",
            Self::Fault => "fault",
            Self::Overhead => "overhead",
            Self::Idle => "idle",
            Self::Unexplained => "unexplained",
        }
    }

    /// The name in style sheets, as in JSON.
    pub const fn name(self) -> &'static str {
        match self {
            Self::OpenShutter => "open_shutter",
            Self::Daytime => "daytime",
            Self::Weather => "weather",
            Self::Fault => "fault",
            Self::Overhead => "overhead",
            Self::Idle => "idle",
            Self::Unexplained => "unexplained",
        }
    }
}

/// The class of a second.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize)]
pub struct Class {
    /// What it was used for.
    pub group: Group,
    /// The kind of overhead, the limit, the device or the reason.
    pub kind: String,
}

impl Class {
    /// A class.
    pub fn new(group: Group, kind: impl Into<String>) -> Self {
        Self { group, kind: kind.into() }
    }
}

/// The kinds of devices as the texts of errors and reasons name them: `dome/dome_1`.
const KINDS: [&str; 10] = [
    "telescope",
    "dome",
    "camera",
    "filterwheel",
    "focuser",
    "rotator",
    "covercalibrator",
    "safetymonitor",
    "observingconditions",
    "switch",
];

/// The first device that a text names.
pub fn device_in(text: &str) -> Option<&str> {
    let is_end = |letter: char| !(letter.is_alphanumeric() || matches!(letter, '/' | '_' | '-' | '.'));
    text.split(is_end).find_map(|word| {
        // A site and a telescope may come first.
        let start = KINDS.iter().filter_map(|kind| word.find(&format!("{kind}/"))).min()?;
        let is_whole = start == 0 || word[..start].ends_with('/');
        is_whole.then(|| word[start..].trim_end_matches('.'))
    })
}

/// The class of a step of an action, in the words that the observatory node publishes.
pub fn of_step(action: &str, step: &str) -> Class {
    let overhead = |kind: &str| Class::new(Group::Overhead, kind);
    let begins = |with: &str| step.starts_with(with);
    if begins("trying again after: ") {
        return Class::new(Group::Fault, device_in(step).unwrap_or("a row failed and was tried again"));
    }
    if begins("waiting for the clouds") {
        return Class::new(Group::Weather, "clouds");
    }
    if begins("waiting for the Sun") || (begins("waiting") && step.contains(": the sky is too ")) {
        return Class::new(Group::Idle, "flats wait for the Sun");
    }
    if begins("waiting for the dome's slit") {
        return overhead("dome slit");
    }
    match step {
        "starting" => return overhead("start of a row"),
        "opening" => return overhead("dome opening"),
        "closing" => return overhead("dome closing"),
        "cooling" | "cooling, filter and focus" => return overhead("cooling"),
        "meridian flip" => return overhead("meridian flip"),
        _ => {}
    }
    if begins("slewing") || begins("back to the") || begins("waiting for the moving target") {
        return overhead("slew");
    }
    if begins("waiting") && step.contains("come to rest") {
        return overhead("settling");
    }
    if begins("correcting by") {
        return overhead("pointing");
    }
    if begins("focusing") || step.ends_with("focusing") {
        return overhead("focus");
    }
    if begins("calibrating") {
        return overhead("guiding");
    }
    match action {
        "autofocus" => overhead("focus"),
        "pointing_model" => overhead("pointing"),
        "calibrate_guiding" => overhead("guiding"),
        "complete_headers" => overhead("headers"),
        "flats" | "calibration" => overhead("calibration frames"),
        "cool_camera" => overhead("cooling"),
        "open" => overhead("dome opening"),
        "close" => overhead("dome closing"),
        _ => overhead("readout and download"),
    }
}

/// The class of the light of a frame; absent where its time is that of its action.
pub fn of_frame(action: &str, image_type: &str) -> Option<Class> {
    let overhead = |kind: &str| Some(Class::new(Group::Overhead, kind));
    match action {
        "autofocus" | "focus" => overhead("focus"),
        "pointing" | "pointing_model" => overhead("pointing"),
        "calibrate_guiding" => overhead("guiding"),
        // Frames of a guide camera are taken while others collect light, and are no light of the schedule.
        "guiding" => None,
        _ if image_type == "Light Frame" => Some(Class::new(Group::OpenShutter, "light")),
        _ => overhead("calibration frames"),
    }
}

/// The kind of overhead of a part whose duration was measured.
pub fn of_timed(part: &str) -> Class {
    let kind = match part {
        "open" => "dome opening",
        "close" => "dome closing",
        "cool" => "cooling",
        "slit" => "dome slit",
        "acquire" => "pointing",
        "spool" => "readout and download",
        other => other,
    };
    Class::new(Group::Overhead, kind)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_device_of_an_error_is_found_in_its_words() {
        assert_eq!(device_in("trying again after: dome/dome_1 failed to open: jammed"), Some("dome/dome_1"));
        assert_eq!(device_in("the node of paranal/callisto/camera/andor was restarted"), Some("camera/andor"));
        assert_eq!(device_in("no either/or here"), None);
        assert_eq!(device_in("pseudodome/x"), None);
        assert_eq!(device_in("zażółć dome/kopuła."), Some("dome/kopuła"));
    }

    #[test]
    fn steps_have_the_kind_that_an_operator_expects() {
        let kind = |action: &str, step: &str| of_step(action, step).kind;
        assert_eq!(kind("object", "slewing"), "slew");
        assert_eq!(kind("object", "3 of 10, 30 s, V"), "readout and download");
        assert_eq!(kind("object", "the stars grow wide: focusing"), "focus");
        assert_eq!(of_step("object", "waiting for the clouds to pass: 12 stars").group, Group::Weather);
        assert_eq!(of_step("flats", "waiting 30 s: the sky is too bright for V").group, Group::Idle);
        assert_eq!(
            of_step("object", "trying again after: telescope/mount failed to slew: x"),
            Class::new(Group::Fault, "telescope/mount")
        );
    }
}
