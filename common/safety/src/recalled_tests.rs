//! Scenarios of interruptions: of the observatory node, of the device nodes, of the link between them and of the Alpaca
//! server, one of them and several within one dwell.

use std::collections::BTreeMap;

use contract::device::record::{EarlierStates, StateEntry, StateRecord};
use contract::observatory::Verdict;
use contract::{BootId, Datum, DeviceState, NoData, Payload, Stamped};
use proptest::prelude::*;
use units::Utc;

use super::*;
use crate::fixture::{self, air, m, wx};
use crate::judge::{Judgement, judge};
use crate::recall::{Asked, Recall};
use crate::stored_history::{Moment, StoredHistory};

/// Each dwell, s; sky time runs like the machine's.
const DWELL_S: u64 = 120;
/// The first interruption begins; the largest wind of a minute was known, and good for its dwell, long before.
const BEGINS_S: u64 = 300;

fn at(second: u64) -> Now {
    fixture::at(second, 1.0)
}

fn moment(second: u64) -> Moment {
    fixture::moment(second, 1.0)
}

/// 8 s are allowed of the monitor.
fn rules() -> Rules {
    fixture::rules(DWELL_S, 8, 60)
}

/// What interrupts the way from a reading to the verdict.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Interruption {
    /// The observatory node is killed and started again.
    Observatory,
    /// The observatory node hangs, and goes on.
    Hang,
    /// The observatory node hangs, and is killed for that and started again.
    HangEnded,
    /// The device nodes are killed and started again.
    DeviceNodes,
    /// Nothing reaches the observatory node.
    Cut,
    /// The Alpaca server refuses connections.
    Server,
    /// `starmesh up` is killed with all nodes and started again.
    Up,
}

use Interruption::{Cut, DeviceNodes, Hang, HangEnded, Observatory, Server, Up};

impl Interruption {
    const ALL: [Self; 7] = [Observatory, Hang, HangEnded, DeviceNodes, Cut, Server, Up];

    /// How long it usually takes, s.
    fn seconds(self) -> u64 {
        match self {
            Server => 1,
            Observatory | DeviceNodes | Up => 2,
            Hang | HangEnded | Cut => 30,
        }
    }

    /// It is over within the allowed age of all readings.
    fn is_short(self) -> bool {
        self.seconds() < 8
    }
}

/// What happens, from when on, and for so many seconds.
type Event = (Interruption, u64, u64);

/// One state as it was published.
struct Published<F> {
    second: u64,
    boot_id: BootId,
    seq: u64,
    link: Link,
    fields: F,
}

/// A device node, and what its incarnations have published: all of it is on its disk.
struct DeviceNode<F> {
    boot_id: BootId,
    published: Vec<Published<F>>,
}

impl<F: Payload + PartialEq> DeviceNode<F> {
    fn new() -> Self {
        Self { boot_id: BootId::fresh(), published: Vec::new() }
    }

    fn publish(&mut self, second: u64, link: Link, fields: F) {
        let newest = self.published.last().filter(|newest| newest.boot_id == self.boot_id);
        let seq = newest.map_or(0, |newest| newest.seq + 1);
        self.published.push(Published { second, boot_id: self.boot_id.clone(), seq, link, fields });
    }

    fn newest(&self) -> Stamped<DeviceState<F>> {
        let newest = self.published.last().unwrap();
        Stamped {
            boot_id: newest.boot_id.clone(),
            seq: newest.seq,
            at_utc: Utc::EPOCH,
            sent_s: None,
            held_s: None,
            body: state(newest.link.clone(), newest.fields.clone()),
        }
    }

    /// What it answers at this second.
    fn record(&self, second: u64) -> StateRecord<F> {
        let mut record =
            StateRecord { boot_id: self.boot_id.clone(), speed: 1.0, entries: Vec::new(), earlier: Vec::new() };
        for state in &self.published {
            let entry = StateEntry {
                seq: state.seq,
                age_s: (second - state.second) as f64,
                reading_ages_s: BTreeMap::new(),
                link: state.link.clone(),
                fields: state.fields.clone(),
            };
            if state.boot_id == self.boot_id {
                record.entries.push(entry);
                continue;
            }
            match record.earlier.last_mut().filter(|run| run.boot_id == state.boot_id) {
                Some(run) => run.entries.push(entry),
                None => record.earlier.push(EarlierStates { boot_id: state.boot_id.clone(), entries: vec![entry] }),
            }
        }
        record
    }
}

/// An incarnation of the observatory node.
struct ObservatoryNode {
    began: u64,
    history: History,
    monitor: Recall<Monitor>,
    station: Recall<Weather>,
}

/// A site with its nodes, which lives second by second.
struct Site {
    rules: Rules,
    events: Vec<Event>,
    device_nodes_run: bool,
    /// A restarted device node finds nothing on its disk.
    disk_is_damaged: bool,
    monitor: DeviceNode<Monitor>,
    station: DeviceNode<Weather>,
    node: Option<ObservatoryNode>,
    file: Option<StoredHistory>,
    /// What one has who received everything at once.
    listener: History,
}

impl Site {
    fn new(events: &[Event]) -> Self {
        let rules = rules();
        Self {
            events: events.to_vec(),
            device_nodes_run: true,
            disk_is_damaged: false,
            monitor: DeviceNode::new(),
            station: DeviceNode::new(),
            node: None,
            file: None,
            listener: History::new(&rules, at(0).sky),
            rules,
        }
    }

    /// Is there such an interruption at this second, which began then or later?
    fn is(&self, interruption: Interruption, second: u64, began: u64) -> bool {
        self.events.iter().any(|(what, from, seconds)| {
            *what == interruption && *from >= began && (*from..*from + *seconds).contains(&second)
        })
    }

    /// A second passes; true if the observatory node received what was published in it.
    fn live(&mut self, second: u64, wind_mps: f64) -> bool {
        let is_any = |whats: &[Interruption]| whats.iter().any(|what| self.is(*what, second, 0));
        let (devices_are_down, node_is_down) = (is_any(&[DeviceNodes, Up]), is_any(&[Observatory, HangEnded, Up]));
        if devices_are_down {
            self.device_nodes_run = false;
        } else {
            self.publish(second, wind_mps);
        }
        if node_is_down {
            self.node = None;
            return false;
        }
        let began = self.node.as_ref().map_or(second, |node| node.began);
        if self.node.is_none() {
            self.begin(second);
        }
        if self.is(Hang, second, began) {
            return false;
        }
        let hears = !devices_are_down && !self.is(Cut, second, 0);
        if hears {
            self.hear(second);
        }
        self.file = self.node.as_ref().map(|node| node.history.store(&self.rules, &moment(second)));
        hears
    }

    fn publish(&mut self, second: u64, wind_mps: f64) {
        let (link, missing) = if !std::mem::replace(&mut self.device_nodes_run, true) {
            (self.monitor.boot_id, self.station.boot_id) = (BootId::fresh(), BootId::fresh());
            (Link::Connecting, Some(NoData::never_read()))
        } else if self.is(Server, second, 0) {
            let refused = NoData::new("transport", "connection refused");
            (Link::Lost { reason: refused.clone() }, Some(refused))
        } else {
            (Link::Connected, None)
        };
        let wind_mps = missing.map_or(Datum::Known(wind_mps), Datum::missing);
        let is_safe = wind_mps.clone().map(|wind_mps| wind_mps <= 12.0);
        self.monitor.publish(second, link.clone(), Monitor { is_safe, gapless_safe_s: 0.0 });
        self.station.publish(second, link, air(second, wind_mps));
        let (monitor, station) = (self.monitor.newest().body, self.station.newest().body);
        self.listener.observe_monitor(&self.rules, &m(), &monitor, at(second));
        self.listener.observe_weather(&self.rules, &wx(), &station, 1.0, at(second));
    }

    /// The observatory node begins with its file.
    fn begin(&mut self, second: u64) {
        let mut history = History::new(&self.rules, at(second).sky);
        if let Some(file) = &self.file {
            history.restore(&self.rules, file, &moment(second)).unwrap();
        }
        let (monitor, station) = (Recall::default(), Recall::default());
        self.node = Some(ObservatoryNode { began: second, history, monitor, station });
    }

    /// The observatory node receives what was published, and asks for what it missed.
    fn hear(&mut self, second: u64) {
        let Some(ObservatoryNode { history, monitor, station, .. }) = &mut self.node else { return };
        let sample = self.monitor.newest();
        let has_missed = monitor.observe(&sample, at(second));
        if has_missed {
            history.miss(&self.rules, &m(), monitor.hole().unwrap());
        }
        history.observe_monitor(&self.rules, &m(), &sample.body, at(second));
        if has_missed {
            let states = missed(monitor, self.monitor.record(second), self.disk_is_damaged, second);
            history.recall_monitor(&self.rules, &m(), states);
        }
        let sample = self.station.newest();
        let has_missed = station.observe(&sample, at(second));
        if has_missed {
            history.miss(&self.rules, &wx(), station.hole().unwrap());
        }
        history.observe_weather(&self.rules, &wx(), &sample.body, 1.0, at(second));
        if has_missed {
            let states = missed(station, self.station.record(second), self.disk_is_damaged, second);
            // The first record of all holds one state, in which nothing moves.
            let _ = history.recall_weather(&self.rules, &wx(), states, 1.0);
        }
    }

    fn is_settled(&self) -> bool {
        self.node.as_ref().is_some_and(|node| node.history.all_received())
    }

    fn judged(&self, second: u64) -> Judgement {
        judge(&self.rules, &self.node.as_ref().unwrap().history, at(second))
    }
}

/// What an observatory node takes of the answer of a device node.
fn missed<F: Payload + PartialEq>(
    recall: &mut Recall<F>,
    mut record: StateRecord<F>,
    disk_is_damaged: bool,
    second: u64,
) -> Vec<PlacedState<F>> {
    if disk_is_damaged {
        record.earlier.clear();
    }
    let asked = Asked { at: at(second).machine, answered: at(second), speed: 1.0 };
    let states = recall.place(&record, asked).unwrap_or_default();
    recall.close();
    states
}

#[test]
fn of_any_two_interruptions_within_a_dwell_neither_starts_it_anew() {
    let pairs = Interruption::ALL.into_iter().flat_map(|first| Interruption::ALL.map(|second| (first, second)));
    for (first, second) in pairs {
        // One after the other, and the second one while the first one lasts.
        for pause in [first.seconds() + 5, first.seconds() / 2] {
            let events = [(first, BEGINS_S, first.seconds()), (second, BEGINS_S + pause, second.seconds())];
            let over = BEGINS_S + first.seconds().max(pause + second.seconds()) + 6;
            let (mut site, are_short) = (Site::new(&events), first.is_short() && second.is_short());
            for now in 0..=over {
                let has_heard = site.live(now, 3.0);
                if are_short && has_heard && now >= BEGINS_S && site.is_settled() {
                    assert_eq!(site.judged(now).reasons, [], "{events:?}, at {now}");
                }
            }
            assert_eq!(site.judged(over).reasons, [], "{events:?}");
        }
    }
}

/// What is left of the monitor's dwell, s; `each` gives the wind of each second, or spoils something.
fn left_s(events: &[Event], until: u64, each: impl Fn(&mut Site, u64) -> f64) -> Option<f64> {
    let mut site = Site::new(events);
    for now in 0..=until {
        let wind_mps = each(&mut site, now);
        site.live(now, wind_mps);
    }
    let reasons = site.judged(until).reasons;
    reasons.into_iter().find(|reason| reason.input == "safetymonitor/m").and_then(|reason| reason.clears_in_s)
}

/// Long interruptions, after which the observatory node asks what it missed.
const LONG: [Interruption; 3] = [Hang, HangEnded, Cut];

#[test]
fn what_was_bad_while_nobody_listened_starts_the_dwell_then() {
    for long in LONG {
        for more in [&[][..], &[(DeviceNodes, 315, 2)][..]] {
            let events = [&[(long, 300, 30)][..], more].concat();
            let left_s = left_s(&events, 336, |_, now| if now == 310 { 13.0 } else { 3.0 });
            assert_eq!(left_s, Some(95.0), "good since 311: {events:?}");
        }
    }
}

#[test]
fn a_time_without_readings_starts_the_dwell_also_where_nobody_listened() {
    for long in LONG {
        let events = [(long, 300, 40), (DeviceNodes, 305, 20)];
        assert_eq!(left_s(&events, 346, |_, _| 3.0), Some(100.0), "read again at 326: {events:?}");
    }
}

#[test]
fn without_the_file_of_a_restarted_device_node_only_what_is_known_counts() {
    for (long, wanted_s) in [(Hang, 114.0), (HangEnded, 97.0), (Cut, 114.0)] {
        let events = [(long, 300, 30), (DeviceNodes, 310, 2)];
        let left_s = left_s(&events, 336, |site, _| {
            site.disk_is_damaged = true;
            3.0
        });
        assert_eq!(left_s, Some(wanted_s), "received since 330, or recorded since 313: {events:?}");
    }
}

#[test]
fn a_record_without_what_was_received_before_the_hole_gives_nothing() {
    let spoilt: [fn(&mut Site); 2] = [
        // Another node publishes since then, and says that it has always done so.
        |site| {
            site.monitor.boot_id = BootId::fresh();
            let boot_id = &site.monitor.boot_id;
            site.monitor.published.iter_mut().for_each(|state| state.boot_id = boot_id.clone());
        },
        // The newest received state is another one in the record.
        |site| site.monitor.published[299].fields.gapless_safe_s = 1.0,
    ];
    for spoil in spoilt {
        for long in [Hang, Cut] {
            let left_s = left_s(&[(long, 300, 30)], 336, |site, now| {
                if now == 320 {
                    spoil(site);
                }
                3.0
            });
            assert_eq!(left_s, Some(114.0), "{long:?}");
        }
    }
}

#[test]
fn a_hole_that_is_longer_than_the_memory_of_the_device_node_counts_from_where_that_begins() {
    let left_s = left_s(&[(Hang, 300, 60)], 366, |site, now| {
        if now == 350 {
            site.monitor.published.retain(|state| state.second >= 340);
        }
        3.0
    });
    assert_eq!(left_s, Some(94.0), "its oldest state is of 340");
}

#[test]
fn a_device_node_is_asked_as_far_back_as_the_hole_reaches_and_anybody_looks() {
    let mut node = DeviceNode::<Monitor>::new();
    node.publish(100, Link::Connecting, Monitor::default());
    let (mut recall, longest) = (Recall::<Monitor>::default(), Duration::from_secs(600));
    assert_eq!(recall.back(at(100), longest, 1.0), longest);
    assert!(recall.observe(&node.newest(), at(100)));
    recall.close();
    assert_eq!(recall.back(at(130), longest, 1.0), Duration::from_secs(35));
    assert_eq!(recall.back(at(130), longest, 10.0), Duration::from_secs(350));
    assert_eq!(recall.back(at(130), Duration::from_secs(20), 1.0), Duration::from_secs(20));
    node.publish(101, Link::Connecting, Monitor::default());
    assert!(!recall.observe(&node.newest(), at(101)), "the next one");
    node.boot_id = BootId::fresh();
    node.publish(102, Link::Connecting, Monitor::default());
    assert!(recall.observe(&node.newest(), at(102)), "of another incarnation");
}

/// Winds each second, and what happens meanwhile.
fn nights() -> impl Strategy<Value = (Vec<f64>, Vec<Event>)> {
    let wind = prop_oneof![300 => Just(3.0), 1 => Just(11.0), 1 => Just(13.0)];
    let event = (proptest::sample::select(Interruption::ALL.to_vec()), 20..400_u64, 1..40_u64);
    (proptest::collection::vec(wind, 450), proptest::collection::vec(event, 0..6))
}

proptest! {
    #![proptest_config(ProptestConfig { rng_seed: proptest::test_runner::RngSeed::Fixed(24), ..ProptestConfig::with_cases(60) })]

    #[test]
    fn nobody_is_safe_after_interruptions_where_one_who_received_everything_is_not((winds, events) in nights()) {
        let mut site = Site::new(&events);
        for (second, wind_mps) in (0..).zip(&winds) {
            if site.live(second, *wind_mps) {
                let all = judge(&site.rules, &site.listener, at(second));
                let is_right = site.judged(second).verdict == Verdict::Unsafe || all.verdict == Verdict::Safe;
                prop_assert!(is_right, "at {}: {:?}", second, all.reasons);
            }
        }
    }
}

#[path = "recalled_pending_tests.rs"]
mod pending;
