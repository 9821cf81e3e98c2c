//! The time that devices need in addition to collecting light: measured where there is telemetry of it, else assumed;
//! each figure has its origin.

use std::collections::BTreeMap;

use config::Observatory;

/// A part of a row whose length the nodes write into their diaries when it is done, so that later nights can be
/// planned.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum TimedPart {
    /// From shut to open roof and covers, with the mount out of its park position.
    Open,
    /// From the close request to verified closed, with the mount parked.
    Close,
    /// From a warm sensor to a cold one.
    Cool,
    /// A slew with its settling; its time depends on the way.
    Slew,
    /// From the end of a slew until the slit of the dome has arrived too.
    Slit,
    /// Another filter in the beam, with the focus that belongs to it.
    Filter,
    /// Frames, solving and corrections until the telescope is proven to be on target.
    Acquire,
    /// From the last exposure of a row until its frames are on disk.
    Spool,
}

impl TimedPart {
    /// All of them.
    pub const ALL: [Self; 8] =
        [Self::Open, Self::Close, Self::Cool, Self::Slew, Self::Slit, Self::Filter, Self::Acquire, Self::Spool];

    /// The word in the diary.
    pub const fn word(self) -> &'static str {
        match self {
            Self::Open => "open",
            Self::Close => "close",
            Self::Cool => "cool",
            Self::Slew => "slew",
            Self::Slit => "slit",
            Self::Filter => "filter",
            Self::Acquire => "acquire",
            Self::Spool => "spool",
        }
    }
}

/// The message under which a span's length stands in the diary, with `span`, `took_s` and, of a slew, `deg`.
pub const TOOK: &str = "took";

/// A number, and where it comes from.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Figure {
    /// The value, in the unit of its name.
    pub value: f64,
    /// Of so many measurements, of which it is the median; 0: assumed.
    pub measured: usize,
}

impl Figure {
    /// A number that was never measured.
    pub const fn assumed(value: f64) -> Self {
        Self { value, measured: 0 }
    }
}

/// Pixels of a camera, from its frames.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sensor {
    /// Columns and rows, unbinned px.
    pub size_px: [u32; 2],
    /// Bytes of a stored file per pixel, headers included.
    pub bytes_per_px: f64,
    /// Of so many frames; 0: nothing is known.
    pub measured: usize,
}

/// The sensor of a camera without frames: any size that was assumed could be a hundred times too large or too small.
const UNKNOWN: Sensor = Sensor { size_px: [0, 0], bytes_per_px: 0.0, measured: 0 };

/// The overheads of all steps.
#[derive(Debug, Clone, PartialEq)]
pub struct Overheads {
    spans: BTreeMap<TimedPart, Figure>,
    /// The time that a slew takes per degree of its way in addition to [`TimedPart::Slew`], s/deg.
    pub slew_s_per_deg: Figure,
    /// From the end of a frame's exposure to the begin of the next one, by action, s.
    pub frame_s: BTreeMap<String, Figure>,
    /// ... where none of an action was measured.
    pub other_frame_s: Figure,
    /// From the end of a row's last exposure to the whole headers of all frames, s.
    pub headers_s: Figure,
    /// By camera.
    pub sensors: BTreeMap<String, Sensor>,
}

impl Overheads {
    /// Nothing measured: the configuration's numbers where it has some, else those of a 1 m telescope in a dome.
    pub fn assumed(config: &Observatory) -> Self {
        let settle_s = config.telescope.iter().map(|mount| mount.settle_s).fold(0.0, f64::max);
        let spans = [
            // Half the travel time after which a dome counts as stuck is the usual one.
            (TimedPart::Open, 60.0),
            (TimedPart::Close, 60.0),
            (TimedPart::Cool, 600.0),
            // Ramps of 5 s, then 3 deg/s.
            (TimedPart::Slew, 5.0 + settle_s),
            // A roof, or a dome that is as quick as its mount.
            (TimedPart::Slit, 0.0),
            (TimedPart::Filter, 5.0),
            // A frame and its solving (some s each), a correction, and a frame that proves the result.
            (TimedPart::Acquire, 30.0),
            (TimedPart::Spool, 2.0),
        ];
        Self {
            spans: spans.into_iter().map(|(span, value)| (span, Figure::assumed(value))).collect(),
            slew_s_per_deg: Figure::assumed(1.0 / 3.0),
            frame_s: BTreeMap::new(),
            other_frame_s: Figure::assumed(config.schedule.check.frame_overhead_s),
            headers_s: Figure::assumed(10.0),
            sensors: BTreeMap::new(),
        }
    }

    /// The time of a part of a row, s; of a slew the part that does not depend on its way.
    pub fn span(&self, span: TimedPart) -> Figure {
        self.spans.get(&span).copied().unwrap_or(Figure::assumed(0.0))
    }

    /// Sets the time of a part of a row.
    pub fn set_span(&mut self, span: TimedPart, figure: Figure) {
        self.spans.insert(span, figure);
    }

    /// A slew over so many degrees with its settling, s.
    pub fn slew_s(&self, deg: f64) -> f64 {
        self.span(TimedPart::Slew).value + self.slew_s_per_deg.value * deg
    }

    /// From the end of a frame's exposure to the begin of the next one, s.
    pub fn frame(&self, action: &str) -> Figure {
        self.frame_s.get(action).copied().unwrap_or(self.other_frame_s)
    }

    /// The pixels of a camera.
    pub fn sensor(&self, camera: &str) -> Sensor {
        self.sensors.get(camera).copied().unwrap_or(UNKNOWN)
    }

    /// Every figure with its name, unit and origin, for people: `slew 12.3 s (n = 40)`.
    pub fn figures(&self) -> Vec<(String, Figure, &'static str)> {
        let mut listed: Vec<(String, Figure, &'static str)> =
            TimedPart::ALL.iter().map(|span| (span.word().to_owned(), self.span(*span), "s")).collect();
        listed.push(("slew, each degree".to_owned(), self.slew_s_per_deg, "s/deg"));
        let frames = self.frame_s.iter().map(|(action, figure)| (format!("between frames, {action}"), *figure, "s"));
        listed.extend(frames);
        listed.push(("between frames, any other".to_owned(), self.other_frame_s, "s"));
        listed.push(("headers whole".to_owned(), self.headers_s, "s"));
        listed
    }
}
