//! The table of the bus: every key is declared here once, with its payload, its rate, how zenoh carries it, its writer
//! and its readers.
//!
//! All else is made from it: [`Key`] with its text, the key expressions of subscribers ([`Topic::at`]), `docs/bus.md`,
//! and the list of payloads that golden samples freeze.

use crate::archive;
use crate::archived_frame;
use crate::audit::{self, PublishedRecord};
use crate::device::{
    DeviceDescription, DeviceKind, camera, dome, observing_conditions, of_kind, record, safety_monitor, switch,
};
use crate::keys::Keys;
use crate::node::{DiaryLine, NodeState};
use crate::observatory as state;
use crate::row::{Carried, PayloadType, Piece, Rate, TopicRow};
use crate::table_macro::{bus, payloads, piece, row, words};
use crate::{Address, Chunk, Command, Device, DeviceState, Kind, Name, Order, Reply, Role};

bus! {
    every kind of device: {
        /// What the device can do, and what it reports about itself.
        Capabilities "capabilities" (publishes DeviceDescription<K::Capabilities>) {
            Rate::OnChangeAndEvery(10), Carried::State(1), "device node" => "observatory, web, archive"
        }
        /// What is true of the device now: link, typed fields, readings, last command.
        State "state" (publishes DeviceState<K::Fields>) {
            Rate::AtEveryPoll, Carried::Telemetry, "device node" => "observatory, web, archive"
        }
        /// Asks the device to do something; answered at once, done when its state shows it.
        Command "command" (asks Command<K::Command> => Reply) {
            Rate::WhenAsked, Carried::Query, "observatory; archive, to release frames" => "device node"
        }
    }
    some kinds of device: {
        /// A frame is safe in the spool and can be fetched by HTTP.
        Frame "frame" { Camera (publishes camera::Frame) } {
            Rate::Event, Carried::Event(1000), "device node" => "archive, observatory, web"
        }
        /// The guard's number, the permits that it counts, and what it does.
        Guard "guard" { Dome (publishes dome::Guard) } {
            Rate::Every(1), Carried::Urgent, "device node of the dome" => "observatory, web"
        }
        /// The past states of a device that the verdict rests on: evidence for an observatory node that did not receive them.
        Record "record" {
            SafetyMonitor (asks record::RecordQuestion => record::StateRecord<safety_monitor::Fields>)
            ObservingConditions (asks record::RecordQuestion => record::StateRecord<observing_conditions::Fields>)
            Switch (asks record::RecordQuestion => record::StateRecord<switch::Fields>)
        } {
            Rate::WhenAsked, Carried::Query, "observatory" => "device node"
        }
    }
    parts of the observatory node: {
        /// The verdict, its reasons, and every input with its age.
        Safety "safety" (publishes state::SafetyState) {
            Rate::OnChangeAndEvery(1), Carried::State(1000), "observatory node" => "web, archive"
        }
        /// Which node commands, with which fencing token.
        Lease "lease" (publishes state::Lease) {
            Rate::OnChangeAndEvery(1), Carried::State(1), "observatory node" => "web"
        }
        /// Posture, the robotic switch, and the running actions.
        Night "night" (publishes state::NightState) {
            Rate::OnChangeAndEvery(1), Carried::State(1000), "observatory node" => "web, archive"
        }
        /// The rows of the schedule with their progress.
        Schedule "schedule" (publishes state::ScheduleState) {
            Rate::OnChangeAndEvery(10), Carried::State(1), "observatory node" => "web, archive"
        }
        /// The alerts of all nodes of the telescope.
        Alerts "alerts" (publishes state::Alerts) {
            Rate::OnChangeAndEvery(10), Carried::State(100), "observatory node" => "web, archive"
        }
        /// How far from its targets the telescope points, and the pointing models.
        Pointing "pointing" (publishes state::PointingState) {
            Rate::OnChangeAndEvery(10), Carried::State(1), "observatory node" => "observatory nodes on standby, web"
        }
        /// The state of the guide loop.
        Guiding "guiding" (publishes state::GuidingState) {
            Rate::OnChangeAndEvery(10), Carried::State(1), "observatory node" => "web"
        }
        /// The focus run with all its points, and the best known positions.
        Focus "focus" (publishes state::FocusState) {
            Rate::OnChangeAndEvery(10), Carried::State(1), "observatory node" => "web"
        }
        /// Active orders of operators: what holds until it is revoked or ends.
        OperatorOrders "operator-orders" (publishes state::OperatorOrders) {
            Rate::OnChangeAndEvery(1), Carried::State(1), "observatory node" => "observatory nodes on standby, web"
        }
        /// What solved frames teach: scale, rotation and distortion of each camera, and the best zero points.
        Optics "optics" (publishes state::OpticsState) {
            Rate::OnChangeAndEvery(10), Carried::State(1), "observatory node" => "observatory nodes on standby, web"
        }
        /// What the focus runs of many nights teach; best position, offsets and coefficient are made of it.
        FocusLearned "focus-learned" (publishes state::FocusLearned) {
            Rate::OnChangeAndEvery(10), Carried::State(1), "observatory node" => "observatory nodes on standby"
        }
    }
    of a telescope: {
        /// The places of the stars of a field that guiding holds.
        GuideReference ["observatory" "guiding" "reference"] (publishes state::GuideReference) {
            Rate::Event, Carried::Event(state::GUIDE_REFERENCES), "observatory node" => "observatory nodes on standby"
        }
        /// How far a frame of the guide loop is off, and the pulses that followed.
        Correction ["observatory" "guiding" "correction"] (publishes state::Correction) {
            Rate::Event, Carried::Event(1000), "observatory node" => "archive"
        }
        /// A focus run that has ended, with all its points and the curve.
        FocusRun ["observatory" "focus" "run"] (publishes state::FocusRun) {
            Rate::Event, Carried::Event(100), "observatory node" => "archive, observatory nodes on standby"
        }
        /// An operator's order.
        Order ["observatory" "order"] (asks Order => Reply) {
            Rate::WhenAsked, Carried::Query, "command line" => "observatory node"
        }
        /// The actions that a schedule may use, with the schema of their parameters; a plain `get` brings all.
        Actions ["observatory" "actions"] (asks state::ActionQuestion => state::ActionAnswer) {
            Rate::WhenAsked, Carried::Query, "command line, anybody" => "observatory node"
        }
        /// Checks a schedule, which is not made active; the answer may take seconds for thousands of rows.
        ScheduleCheck ["observatory" "schedule" "check"] (asks state::ScheduleDraft => state::ScheduleFindings) {
            Rate::WhenAsked, Carried::Query, "command line, anybody" => "observatory node"
        }
        /// The text of the active schedule or of one before it, and the list of them.
        ScheduleTexts ["observatory" "schedule" "texts"] (asks state::ScheduleTextQuestion => state::ScheduleTexts) {
            Rate::WhenAsked, Carried::Query, "web, anybody" => "observatory node"
        }
        /// Forecasts a schedule, which is not made active; the answer may take seconds.
        SchedulePlan ["observatory" "schedule" "plan"] (asks state::SchedulePlanQuestion => state::SchedulePlan) {
            Rate::WhenAsked, Carried::Query, "web, anybody" => "observatory node"
        }
        /// A file is safe on the archive's disk.
        Stored ["archive" "stored"] (publishes archive::Stored) {
            Rate::Event, Carried::Event(1000), "archive node" => "web, observatory"
        }
        /// Question and answer about the past.
        History ["archive" "history"] (asks archive::ArchiveQuestion => archive::ArchiveAnswer) {
            Rate::WhenAsked, Carried::Query, "web, command line, anybody" => "archive node"
        }
        /// One stored frame: what is known of it, its header, pieces of its file, pictures and values of its pixels.
        ArchivedFrame ["archive" "frame"] (asks archived_frame::FrameQuestion => archived_frame::FrameAnswer) {
            Rate::WhenAsked, Carried::LargeAnswers, "web, anybody" => "archive node"
        }
        /// The report of a night, as it is now.
        NightReport ["archive" "report"] (asks archived_frame::ReportQuestion => archived_frame::ReportAnswer) {
            Rate::WhenAsked, Carried::LargeAnswers, "web, anybody" => "archive node"
        }
    }
    of a telescope with a name: {
        /// May this dome be open? Silence is a no.
        Permit ["observatory" "permit" {dome}] (publishes state::Permit) {
            Rate::Every(1), Carried::Urgent, "observatory node" => "device nodes of the dome and the mount"
        }
        /// The facts that were measured on a frame.
        Facts ["observatory" "frame" {id} "facts"] (publishes state::FrameFacts) {
            Rate::Event, Carried::Event(2), "observatory node" => "web, archive"
        }
    }
    of a node: {
        /// Health of a node.
        State "state" (publishes NodeState) {
            Rate::Every(5), Carried::State(1), "each node" => "web, command line, archive"
        }
        /// The alerts that a node itself raises.
        Alerts "alerts" (publishes state::Alerts) {
            Rate::OnChangeAndEvery(10), Carried::State(100), "each node" => "observatory, web"
        }
        /// A line of the node's log.
        Diary "diary" (publishes DiaryLine) {
            Rate::Event, Carried::Event(1000), "each node" => "archive, web, command line"
        }
        /// Each order and movement: by whom, when, with which token, and the outcome; each record holds the hash of the last.
        Audit "audit" (publishes PublishedRecord<audit::AuditRecord>) {
            Rate::EventOnDisk, Carried::Event(1000), "device, observatory and web nodes" => "archive, anybody"
        }
        /// The records of the node's own audit file, in portions.
        AuditSince "audit-since" (asks audit::AuditQuestion => audit::AuditAnswer<audit::AuditRecord>) {
            Rate::WhenAsked, Carried::Query, "archive, command line, anybody" => "device, observatory and web nodes"
        }
        /// The node's session lives; a hint only, nobody's safety rests on it.
        Alive "alive" (no payload) {
            Rate::WhileConnected, Carried::Token, "each node" => "web, command line"
        }
    }
}

impl Topic {
    /// The keys of all telescopes of all sites.
    pub fn everywhere(self) -> Keys<'static> {
        Keys::of(self.row().pieces)
    }

    /// The keys of the telescopes of one site.
    pub fn on_site(self, site: &Chunk) -> Keys<'_> {
        self.everywhere().on_site(site)
    }

    /// The keys of one telescope.
    pub fn at(self, address: &Address) -> Keys<'_> {
        self.everywhere().at(address)
    }

    /// The states of all parts of all observatory nodes.
    pub fn every_part() -> Keys<'static> {
        Self::Observatory(Part::Night).everywhere().of_every_part()
    }

    /// The kinds of devices whose keys these are; none where the keys name no device.
    pub fn kinds(self) -> &'static [Kind] {
        self.row()
            .pieces
            .iter()
            .find_map(|piece| if let Piece::Kind(kinds) = piece { Some(*kinds) } else { None })
            .unwrap_or_default()
    }

    /// The types of all its payloads, of every kind of device.
    pub fn payloads(self) -> Vec<PayloadType> {
        let TopicRow { payloads, .. } = self.row();
        match self.kinds() {
            [] => payloads(Kind::Telescope),
            kinds => kinds.iter().flat_map(|kind| payloads(*kind)).collect(),
        }
    }
}

impl Key {
    /// The type of what is published on this key; `None` for questions and for what has no payload.
    pub fn published(&self) -> Option<PayloadType> {
        let kind = match self {
            Self::Capabilities(device) | Self::State(device) | Self::Frame(device) | Self::Guard(device) => device.kind,
            _ => Kind::Telescope,
        };
        (self.topic().row().payloads)(kind).into_iter().find(|payload| payload.is_published)
    }
}

/// The type of each payload of the bus, once.
pub fn payloads() -> Vec<PayloadType> {
    let mut all: Vec<PayloadType> = Vec::new();
    for payload in Topic::ALL.iter().flat_map(|topic| topic.payloads()) {
        if all.iter().all(|known| known.name != payload.name) {
            all.push(payload);
        }
    }
    all
}
