use std::io::Write as _;

use super::*;

fn at(text: &str) -> Utc {
    text.parse().unwrap()
}

/// The journal of a node that commands.
fn own(path: &Path) -> Journal {
    let journal = Journal::open(path).unwrap();
    journal.take_over().unwrap();
    journal
}

const NOW: &str = "2026-11-21T03:00:00Z";

#[test]
fn a_restart_goes_on_counting_where_the_crash_was() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("data").join("journal-callisto.jsonl");
    let row = RowId("a".to_owned());
    let (first, second) = {
        let journal = own(&path);
        let first = journal.intend(&row, at(NOW)).unwrap();
        journal.sent(&row);
        assert!(journal.taken(&first.frame, at(NOW)).unwrap());
        assert!(!journal.taken(&first.frame, at(NOW)).unwrap(), "reported twice, counted once");
        let second = journal.intend(&row, at(NOW)).unwrap();
        journal.sent(&row);
        (first, second)
    };
    assert_eq!((first.sequence, second.sequence), (0, 1));
    // The crash left half a line.
    OpenOptions::new().append(true).open(&path).unwrap().write_all(b"{\"is\":\"tak").unwrap();

    let journal = own(&path);
    assert_eq!(journal.progress(&row), Progress { taken: 1, open: vec![second.frame.clone()], ended: None });
    // The announcement of the frame that was under way arrives after the restart.
    assert!(journal.taken(&second.frame, at(NOW)).unwrap());
    assert_eq!(journal.progress(&row).taken, 2);
    assert_eq!(journal.intend(&row, at(NOW)).unwrap().sequence, 2);
    journal.arrive(journal.end(&row, RowStatus::Finished, "", at(NOW))).unwrap();
    drop(journal);

    let journal = own(&path);
    assert_eq!(journal.progress(&row).ended, Some((RowStatus::Finished, String::new())));
}

#[test]
fn a_frame_that_the_dome_hid_does_not_count_whoever_announces_it_and_whenever() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("j.jsonl");
    let row = RowId("a".to_owned());
    let journal = own(&path);
    let intend = || {
        let frame = journal.intend(&row, at(NOW)).unwrap().frame;
        journal.sent(&row);
        frame
    };
    let (before, after, dimmed) = (intend(), intend(), intend());
    journal.taken(&before, at(NOW)).unwrap();
    journal.hidden(&row, &before, 40.0, false, at(NOW)).unwrap();
    journal.hidden(&row, &after, 40.0, false, at(NOW)).unwrap();
    assert!(!journal.taken(&after, at(NOW)).unwrap());
    journal.hidden(&row, &dimmed, 5.0, true, at(NOW)).unwrap();
    assert!(journal.taken(&dimmed, at(NOW)).unwrap());
    let expected = Progress { taken: 1, open: vec![], ended: None };
    assert_eq!(journal.progress(&row), expected);
    drop(journal);
    assert_eq!(own(&path).progress(&row), expected, "nor after a restart");
}

#[test]
fn a_frame_in_addition_to_the_rows_own_and_one_of_another_place_never_count() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("j.jsonl");
    let row = RowId("a".to_owned());
    let journal = own(&path);
    let aside = journal.aside(&row, at(NOW)).unwrap();
    assert!(std::fs::read_to_string(&path).unwrap().contains(&aside.frame.0), "on disk before it is used");
    let first = journal.intend(&row, at(NOW)).unwrap();
    let second = journal.aside(&row, at(NOW)).unwrap();
    assert_eq!((aside.sequence, first.sequence, second.sequence), (0, 1, 2), "no two frames have one number");
    journal.sent(&row);
    assert!(!journal.taken(&aside.frame, at(NOW)).unwrap());
    assert!(journal.taken(&first.frame, at(NOW)).unwrap());
    assert_eq!(journal.progress(&row).taken, 1);
    journal.astray(&row, &first.frame, f64::NAN, at(NOW)).unwrap();
    let expected = Progress { taken: 0, open: vec![], ended: None };
    assert_eq!(journal.progress(&row), expected);
    assert!(!journal.taken(&first.frame, at(NOW)).unwrap(), "announced once more");
    drop(journal);
    let journal = own(&path);
    assert_eq!(journal.progress(&row), expected, "nor after a restart");
    assert!(!journal.taken(&second.frame, at(NOW)).unwrap());
    assert_eq!(journal.intend(&row, at(NOW)).unwrap().sequence, 3);
}

#[test]
fn an_intent_that_was_not_sent_is_used_again() {
    let folder = tempfile::tempdir().unwrap();
    let journal = own(&folder.path().join("j.jsonl"));
    let row = RowId("a".to_owned());
    let first = journal.intend(&row, at(NOW)).unwrap();
    assert_eq!(journal.intend(&row, at(NOW)).unwrap(), first);
    journal.sent(&row);
    assert_eq!(journal.intend(&row, at(NOW)).unwrap().sequence, 1);
}

#[test]
fn the_id_is_on_disk_before_it_is_used() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("j.jsonl");
    let journal = own(&path);
    let intent = journal.intend(&RowId("a".to_owned()), at(NOW)).unwrap();
    assert!(std::fs::read_to_string(&path).unwrap().contains(&intent.frame.0));
}

#[test]
fn old_nights_are_dropped_and_strangers_are_not_counted() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("j.jsonl");
    let (old, new) = (RowId("old".to_owned()), RowId("new".to_owned()));
    let journal = own(&path);
    journal.arrive(journal.end(&old, RowStatus::Finished, "", at("2026-11-01T03:00:00Z"))).unwrap();
    journal.arrive(journal.end(&new, RowStatus::Failed, "why", at(NOW))).unwrap();
    journal.robotic_on(at(NOW)).unwrap();
    assert!(!journal.taken(&CommandId("of another program".to_owned()), at(NOW)).unwrap());
    drop(journal);
    let journal = own(&path);
    assert_eq!(journal.progress(&old).ended, None);
    assert_eq!(journal.progress(&new).ended, Some((RowStatus::Failed, "why".to_owned())));
    assert_eq!(journal.last_robotic(), Some((at(NOW), true)));
}

#[test]
fn the_robotic_switch_is_on_once_that_is_on_disk_and_off_at_once() {
    let folder = tempfile::tempdir().unwrap();
    let data = folder.path().join("data");
    let journal = Journal::open(&data.join("j.jsonl")).unwrap();
    // The disk is gone.
    std::fs::remove_dir(&data).unwrap();
    assert!(journal.robotic_on(at(NOW)).is_err());
    assert_eq!(journal.last_robotic(), None);
    journal.robotic_off(at(NOW));
    let refused = journal.write_switch().unwrap_err().to_string();
    assert!(refused.contains("j.jsonl: "), "{refused}");
    assert_eq!(journal.last_robotic(), Some((at(NOW), false)));
    std::fs::create_dir(&data).unwrap();
    journal.write_switch().unwrap();
    let on_disk = || Journal::last_robotic_in(&data.join("j.jsonl")).unwrap();
    assert_eq!(on_disk(), Some((at(NOW), false)), "it is tried again");
    // What was not written is over when it is turned on.
    std::fs::remove_dir_all(&data).unwrap();
    journal.robotic_off(at(NOW));
    assert!(journal.write_switch().is_err());
    std::fs::create_dir(&data).unwrap();
    journal.robotic_on(at(NOW)).unwrap();
    journal.write_switch().unwrap();
    assert_eq!((journal.last_robotic(), on_disk()), (Some((at(NOW), true)), Some((at(NOW), true))));
}

#[test]
fn an_off_that_is_tried_again_is_not_written_after_a_later_on() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("j.jsonl");
    let journal = own(&path);
    for _ in 0..50 {
        journal.robotic_off(at(NOW));
        std::thread::scope(|scope| {
            let slow = journal.hang();
            scope.spawn(|| journal.robotic_on(at(NOW)).unwrap());
            scope.spawn(|| journal.write_switch().unwrap());
            // Time for both to come.
            (0..1000).for_each(|_| std::thread::yield_now());
            drop(slow);
        });
        let turned = Some((at(NOW), true));
        assert_eq!((journal.last_robotic(), Journal::last_robotic_in(&path).unwrap()), (turned, turned));
    }
    assert!(journal.records().on_the_way.is_empty());
}

#[test]
fn an_off_that_waits_for_the_disk_is_over_where_another_node_was_turned_on_since() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("j.jsonl");
    let (waiting, other) = (own(&path), own(&path));
    let later = |s: f64| Utc::from_seconds(at(NOW).seconds() + s);
    waiting.robotic_off(later(0.0));
    other.robotic_on(later(1.0)).unwrap();
    waiting.take_over().unwrap();
    assert_eq!(waiting.last_robotic(), Some((later(1.0), true)));
    waiting.write_switch().unwrap();
    assert_eq!(Journal::last_robotic_in(&path).unwrap(), Some((later(1.0), true)));
    // One that was ordered since then is the last word.
    waiting.robotic_off(later(2.0));
    waiting.take_over().unwrap();
    waiting.write_switch().unwrap();
    assert_eq!(Journal::last_robotic_in(&path).unwrap(), Some((later(2.0), false)));
}

#[test]
fn an_end_that_waits_for_the_disk_is_not_written_after_the_order_that_has_the_row_run_again() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("j.jsonl");
    let row = RowId("a".to_owned());
    let journal = own(&path);
    let ended = journal.end(&row, RowStatus::Failed, "why", at(NOW));
    journal.again(&row, false, at(NOW)).unwrap();
    journal.arrive(ended).unwrap();
    assert_eq!(journal.progress(&row).ended, None);
    assert_eq!(std::fs::read_to_string(&path).unwrap().matches("\"ended\"").count(), 1);
    drop(journal);
    assert_eq!(own(&path).progress(&row).ended, None, "nor after a restart");
}

#[test]
fn those_who_wait_for_a_disk_that_hangs_hold_one_thread_together() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("j.jsonl");
    let journal = Arc::new(own(&path));
    journal.robotic_off(at(NOW));
    let runtime = tokio::runtime::Builder::new_current_thread().enable_time().max_blocking_threads(2).build().unwrap();
    let hangs = journal.hang();
    let writing: Vec<_> = runtime.block_on(async {
        let write = || {
            let journal = journal.clone();
            tokio::spawn(async move { journal.write_switch_in_turn().await })
        };
        let writing = (0..4).map(|_| write()).collect();
        tokio::task::yield_now().await;
        // The second thread is left for others.
        let other = tokio::time::timeout(test_support::LIMIT, tokio::task::spawn_blocking(|| {}));
        other.await.unwrap().unwrap();
        writing
    });
    drop(hangs);
    runtime.block_on(async {
        for written in writing {
            written.await.unwrap().unwrap();
        }
    });
    assert_eq!(Journal::last_robotic_in(&path).unwrap(), Some((at(NOW), false)));
}

#[test]
fn a_line_after_one_of_which_a_full_disk_took_half_is_whole() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("j.jsonl");
    let journal = own(&path);
    // A file that takes nothing, and as much of the line as found room.
    let well = journal.file.lock().unwrap().replace(File::open(&path).unwrap());
    journal.robotic_off(at(NOW));
    assert!(journal.write_switch().is_err());
    OpenOptions::new().append(true).open(&path).unwrap().write_all(b"{\"is\":\"robotic\",\"at").unwrap();
    *journal.file.lock().unwrap() = well;
    journal.write_switch().unwrap();
    assert_eq!(Journal::last_robotic_in(&path).unwrap(), Some((at(NOW), false)));
}

#[test]
fn who_takes_over_knows_what_was_done_and_the_one_before_disturbs_it_no_more() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("j.jsonl");
    let row = RowId("a".to_owned());
    let (first, standby) = (own(&path), Journal::open(&path).unwrap());
    let frame = first.intend(&row, at(NOW)).unwrap().frame;
    first.sent(&row);
    first.taken(&frame, at(NOW)).unwrap();
    // An order that a standby received while nobody commanded.
    standby.robotic_off(at(NOW));
    standby.write_switch().unwrap();
    standby.take_over().unwrap();
    assert_eq!((standby.progress(&row).taken, standby.last_robotic()), (1, Some((at(NOW), false))));
    // It was only stopped, and goes on.
    first.arrive(first.end(&row, RowStatus::Finished, "", at(NOW))).unwrap();
    assert_eq!(standby.intend(&row, at(NOW)).unwrap().sequence, 1);
    drop((first, standby));
    let next = own(&path);
    assert_eq!((next.progress(&row).taken, next.progress(&row).ended), (1, None));
}

#[test]
fn a_frame_that_is_counted_while_the_journal_is_taken_over_is_not_forgotten() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("j.jsonl");
    let row = RowId("a".to_owned());
    let frame = {
        let before = own(&path);
        let frame = before.intend(&row, at(NOW)).unwrap().frame;
        before.sent(&row);
        frame
    };
    let journal = Journal::open(&path).unwrap();
    std::thread::scope(|scope| {
        let mut file = journal.file.lock().unwrap();
        // Announced while the file is being read: its line waits.
        let counting = scope.spawn(|| journal.taken(&frame, at(NOW)).unwrap());
        let began = std::time::Instant::now();
        while journal.progress(&row).taken == 0 {
            assert!(began.elapsed() < test_support::LIMIT, "it is not counted");
            std::thread::yield_now();
        }
        journal.read_anew(&mut file).unwrap();
        assert_eq!(journal.progress(&row).taken, 1, "forgotten, and so taken again");
        drop(file);
        assert!(counting.join().unwrap());
    });
    assert!(!journal.taken(&frame, at(NOW)).unwrap());
    drop(journal);
    assert_eq!(own(&path).progress(&row), Progress { taken: 1, ..Progress::default() });
}

#[test]
fn a_frame_that_two_report_at_once_is_counted_and_written_once() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("j.jsonl");
    let (row, journal) = (RowId("a".to_owned()), own(&path));
    for _ in 0..50 {
        let frame = journal.intend(&row, at(NOW)).unwrap().frame;
        journal.sent(&row);
        let counted = std::thread::scope(|scope| {
            let take = || journal.taken(&frame, at(NOW)).unwrap();
            let (announced, stored) = (scope.spawn(take), scope.spawn(take));
            usize::from(announced.join().unwrap()) + usize::from(stored.join().unwrap())
        });
        assert_eq!(counted, 1);
    }
    let lines = read(&path).unwrap();
    assert_eq!(lines.0.iter().filter(|line| matches!(line, JournalLine::Taken { .. })).count(), 50);
    assert!(journal.records().on_the_way.is_empty());
}

#[test]
fn flats_are_counted_by_filter_across_a_crash_and_what_nobody_judged_is_known() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("j.jsonl");
    let row = RowId("a".to_owned());
    let journal = own(&path);
    let take = || {
        let frame = journal.intend(&row, at(NOW)).unwrap().frame;
        journal.sent(&row);
        assert!(journal.taken(&frame, at(NOW)).unwrap());
        frame
    };
    let filter = |name: &str| Some(name.to_owned());
    let (good, other, dark, unjudged) = (take(), take(), take(), take());
    journal.judged(&row, &good, filter("B"), Some(30_000.0), true, at(NOW)).unwrap();
    journal.judged(&row, &other, filter("V"), Some(31_000.0), true, at(NOW)).unwrap();
    journal.judged(&row, &dark, filter("B"), None, false, at(NOW)).unwrap();
    drop(journal);

    let journal = own(&path);
    assert!(!journal.taken(&dark, at(NOW)).unwrap(), "announced again, it still does not count");
    let flats = journal.flats(&row);
    assert_eq!(flats.good, [("B".to_owned(), 1), ("V".to_owned(), 1)].into());
    assert_eq!(flats.unjudged, [unjudged]);
    assert_eq!((journal.progress(&row).taken, journal.flats(&RowId("b".to_owned()))), (3, Flats::default()));
}

#[test]
fn a_journal_that_is_cut_off_at_any_byte_counts_what_was_whole_and_uses_no_number_again() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("j.jsonl");
    let row = RowId("a".to_owned());
    {
        let journal = own(&path);
        for _ in 0..4 {
            let intent = journal.intend(&row, at(NOW)).unwrap();
            journal.sent(&row);
            journal.taken(&intent.frame, at(NOW)).unwrap();
        }
        journal.arrive(journal.end(&row, RowStatus::Finished, "done", at(NOW))).unwrap();
    }
    let whole = std::fs::read(&path).unwrap();
    let cut_path = folder.path().join("cut.jsonl");
    for cut in 0..=whole.len() {
        let part = &whole[..cut];
        // A line without its end counts where all of it but the end is there.
        let lines: Vec<&[u8]> = part.split(|byte| *byte == b'\n').collect();
        let is_whole = |line: &&&[u8]| serde_json::from_slice::<serde_json::Value>(line).is_ok();
        let count = |word: &str| {
            let has = |line: &&&[u8]| String::from_utf8_lossy(line).contains(&format!("\"is\":\"{word}\""));
            lines.iter().filter(is_whole).filter(has).count() as u32
        };
        std::fs::write(&cut_path, part).unwrap();
        let journal = Journal::open(&cut_path).unwrap();
        let progress = journal.progress(&row);
        assert_eq!(progress.taken, count("taken"), "cut at {cut}");
        assert_eq!(progress.taken as usize + progress.open.len(), count("intended") as usize, "cut at {cut}");
        assert_eq!(progress.ended.is_some(), count("ended") == 1, "cut at {cut}");
        // As an incarnation that dies within a line, and the next one, would go on.
        if cut % 97 == 0 {
            journal.take_over().unwrap();
            assert_eq!(journal.progress(&row), progress, "cut at {cut}");
            assert_eq!(journal.intend(&row, at(NOW)).unwrap().sequence, count("intended"), "cut at {cut}");
            assert_eq!(Journal::open(&cut_path).unwrap().progress(&row).open.len(), progress.open.len() + 1);
        }
    }
}

#[test]
fn a_journal_with_a_spoilt_line_is_put_aside_before_it_is_written_anew() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("j.jsonl");
    let row = RowId("a".to_owned());
    {
        let journal = own(&path);
        journal.intend(&row, at(NOW)).unwrap();
        journal.arrive(journal.end(&row, RowStatus::Finished, "done", at(NOW))).unwrap();
    }
    // A disk that lost power gave back zeros in place of a line.
    let mut spoilt = std::fs::read(&path).unwrap();
    let first_line = spoilt.iter().position(|byte| *byte == b'\n').unwrap();
    spoilt[..first_line].fill(0);
    std::fs::write(&path, &spoilt).unwrap();
    let asides = || {
        let files = std::fs::read_dir(folder.path()).unwrap().map(|file| file.unwrap().path());
        files.filter(|file| file.to_string_lossy().contains("j.jsonl.bad-")).collect::<Vec<_>>()
    };
    let journal = Journal::open(&path).unwrap();
    assert_eq!(asides().len(), 0, "who only reads keeps nothing");
    assert!(journal.progress(&row).ended.is_some(), "the lines around it hold");
    journal.take_over().unwrap();
    assert_eq!(std::fs::read(&asides()[0]).unwrap(), spoilt);
    Journal::open(&path).unwrap().take_over().unwrap();
    assert_eq!(asides().len(), 1);
}

#[test]
fn an_end_counts_before_it_is_on_disk_and_a_new_lease_meanwhile_does_not_lose_it() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("j.jsonl");
    let row = RowId("a".to_owned());
    let journal = own(&path);
    journal.robotic_on(at(NOW)).unwrap();
    let ended = journal.end(&row, RowStatus::Finished, "done", at(NOW));
    journal.robotic_off(at(NOW));
    let is_known = || {
        let finished = Some((RowStatus::Finished, "done".to_owned()));
        journal.progress(&row).ended == finished && journal.last_robotic() == Some((at(NOW), false))
    };
    assert!(is_known());
    // The disk is slow, and another lease comes: the file has neither line yet.
    journal.take_over().unwrap();
    assert!(is_known());
    journal.arrive(ended).unwrap();
    journal.write_switch().unwrap();
    assert!(is_known());
    let lines = std::fs::read_to_string(&path).unwrap();
    assert_eq!(lines.matches("\"ended\"").count(), 1);
    drop(journal);
    assert_eq!(own(&path).progress(&row).ended, Some((RowStatus::Finished, "done".to_owned())));
}

#[test]
fn a_row_that_runs_again_counts_from_where_it_stopped_or_anew_also_after_a_restart() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("j.jsonl");
    let row = RowId("a".to_owned());
    let journal = own(&path);
    let intend = |journal: &Journal| {
        let intent = journal.intend(&row, at(NOW)).unwrap();
        journal.sent(&row);
        intent
    };
    let (first, second) = (intend(&journal), intend(&journal));
    journal.taken(&first.frame, at(NOW)).unwrap();
    journal.end_by_order(&row, RowStatus::Skipped, "clouds", at(NOW)).unwrap();
    assert_eq!(journal.progress(&row).ended, Some((RowStatus::Skipped, "clouds".to_owned())));
    journal.again(&row, false, at(NOW)).unwrap();
    let expected = Progress { taken: 1, open: vec![second.frame.clone()], ended: None };
    assert_eq!(journal.progress(&row), expected);
    assert_eq!(own(&path).progress(&row), expected, "nor after a restart");

    let journal = own(&path);
    journal.again(&row, true, at(NOW)).unwrap();
    assert_eq!(journal.progress(&row), Progress::default());
    for late in [&first, &second] {
        assert!(!journal.taken(&late.frame, at(NOW)).unwrap(), "a frame of before, announced once more");
    }
    assert_eq!(intend(&journal).sequence, 2, "no two frames have one number");
    drop(journal);
    assert_eq!(own(&path).progress(&row).taken, 0);
}
