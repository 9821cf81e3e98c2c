//! How the guard process ends after it was asked to: once everything is closed, or when its time is over.

use units::MachineTime;

use crate::watch::{Watch, Who};

/// What the guard process still lacks for its end.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub enum ProcessEnd<'a> {
    /// The node, or a dome: the next round shows more.
    Waits,
    /// The node hangs or waits for a mount, and this process has closed every dome: the node is killed.
    Kill,
    /// Nothing: every dome is closed.
    Closed,
    /// Its time is over, and these domes are not verified closed.
    Open(Vec<&'a str>),
    /// It knows of no dome that it could close.
    KnowsNothing,
}

/// What is known of the enclosures at the end.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub struct AtEnd<'a> {
    /// The node still runs.
    pub node_runs: bool,
    /// The time for an end is over.
    pub is_late: bool,
    /// The domes that this process can close, and whether it has verified them closed.
    pub domes: Vec<(&'a str, bool)>,
    /// Domes that no configuration names any more and that are not let go yet.
    pub leaving: Vec<&'a str>,
}

impl<'a> AtEnd<'a> {
    /// What is lacking, by the watch over the node.
    pub fn decide(self, watch: &Watch, now: MachineTime) -> ProcessEnd<'a> {
        let Self { node_runs, is_late, domes, leaving } = self;
        if node_runs && !is_late {
            // One that waits for a mount has asked the dome for nothing, and so cannot prove that it is closed.
            let hangs = |dome: &str| matches!(watch.who(dome, now), Who::This | Who::Both);
            let is_closed = domes.iter().all(|(dome, is_verified)| hangs(dome) && *is_verified);
            return if is_closed && !domes.is_empty() { ProcessEnd::Kill } else { ProcessEnd::Waits };
        }
        if domes.is_empty() {
            return ProcessEnd::KnowsNothing;
        }
        let open = domes.into_iter().filter(|(dome, is_verified)| !is_verified && !watch.node_reports_closed(dome));
        let open: Vec<&str> = open.map(|(dome, _)| dome).chain(leaving).collect();
        match (open.is_empty(), is_late) {
            (true, _) => ProcessEnd::Closed,
            (false, true) => ProcessEnd::Open(open),
            (false, false) => ProcessEnd::Waits,
        }
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;
    use std::time::Duration;

    use super::*;
    use crate::deadlines::Before;
    use crate::report::{DomeReport, Report, nanos};

    fn now() -> MachineTime {
        MachineTime::from_boot(Duration::from_secs(1000))
    }

    /// A watch that was asked to end, over a node with this report.
    fn watch(report: Option<DomeReport>) -> Watch {
        let mut watch = Watch::new(now(), &[("d".to_owned(), Duration::from_secs(10))], &Before::Nothing, true);
        watch.started(now(), Vec::new());
        if let Some(report) = report {
            watch.observe(now(), &Report { domes: [("d".to_owned(), report)].into(), tokens: BTreeMap::new() });
        }
        watch.end();
        watch
    }

    #[test]
    fn a_process_ends_when_all_is_closed_or_its_time_is_over() {
        let sees = DomeReport {
            at_ns: nanos(now()),
            may_be_open_ms: 0,
            sees: true,
            is_closed: false,
            waits_for_mounts: false,
        };
        let closed = DomeReport { is_closed: true, ..sees.clone() };
        let waits = DomeReport { waits_for_mounts: true, ..sees.clone() };
        let open = || ProcessEnd::Open(vec!["d"]);
        // By the node's report, whether it runs, whether the time is over and whether the dome is verified closed.
        let scenarios = [
            ("the node closes", Some(sees.clone()), true, false, false, ProcessEnd::Waits),
            ("it has not reported yet that it did", Some(sees.clone()), true, false, true, ProcessEnd::Waits),
            ("it waits for a mount", Some(waits.clone()), true, false, false, ProcessEnd::Waits),
            ("... and this process closed it", Some(waits), true, false, true, ProcessEnd::Kill),
            ("it hangs", None, true, false, false, ProcessEnd::Waits),
            ("... and this process closed it", None, true, false, true, ProcessEnd::Kill),
            ("it has ended, and reported closed", Some(closed.clone()), false, false, false, ProcessEnd::Closed),
            ("it has ended", Some(sees.clone()), false, false, false, ProcessEnd::Waits),
            ("... and this process closed it", Some(sees.clone()), false, false, true, ProcessEnd::Closed),
            ("nobody closed it in time", Some(sees.clone()), false, true, false, open()),
            ("nor did a node that runs on", Some(sees), true, true, false, open()),
            ("closed at the last moment", Some(closed), true, true, true, ProcessEnd::Closed),
        ];
        for (name, report, node_runs, is_late, is_verified, expected) in scenarios {
            let at_end = AtEnd { node_runs, is_late, domes: vec![("d", is_verified)], leaving: Vec::new() };
            assert_eq!(at_end.decide(&watch(report), now()), expected, "{name}");
        }
    }

    #[test]
    fn a_dome_that_is_not_let_go_holds_the_end_up_and_where_nothing_is_known_nothing_is_claimed() {
        let at_end = |is_late, domes, leaving| AtEnd { node_runs: false, is_late, domes, leaving };
        let watch = watch(None);
        assert_eq!(at_end(false, vec![("d", true)], vec!["old"]).decide(&watch, now()), ProcessEnd::Waits);
        assert_eq!(at_end(true, vec![("d", true)], vec!["old"]).decide(&watch, now()), ProcessEnd::Open(vec!["old"]));
        assert_eq!(at_end(false, vec![], vec![]).decide(&watch, now()), ProcessEnd::KnowsNothing);
    }
}
