use super::*;

/// What is known after each frame.
fn known(widths: &[f64]) -> Vec<Option<f64>> {
    let mut known = Widths::default();
    let observe = |width: &f64| {
        known.observe(*width, None);
        known.known_px()
    };
    widths.iter().map(observe).collect()
}

#[test]
fn one_or_two_odd_frames_teach_nothing() {
    for odd in [[1.3, 1.2], [9.0, 14.0], [9.0, 9.1], [40.0, 1.0]] {
        let found = known(&[3.9, 4.0, odd[0], odd[1], 3.8]);
        assert_eq!(found, [Some(3.9), Some(4.0), Some(4.0), Some(4.0), Some(3.8)], "{odd:?}");
    }
}

#[test]
fn no_number_of_frames_teaches_what_no_pixel_can_show() {
    for impossible in [0.0, 0.2, 0.6, -3.0, f64::NAN, f64::INFINITY] {
        assert_eq!(known(&[3.9; 3]).last(), known(&[[3.9; 3].as_slice(), &[impossible; 60]].concat()).last());
        assert_eq!(known(&[impossible; 60]), [None; 60]);
    }
}

#[test]
fn a_change_of_focus_is_followed_at_the_third_frame() {
    for now in [2.0, 8.0, 20.0] {
        let found = known(&[4.0, 4.0, now, 1.05 * now, now]);
        assert_eq!(found, [Some(4.0), Some(4.0), Some(4.0), Some(4.0), Some(now)]);
    }
    let slow: Vec<f64> = (0..20).map(|n| 3.0 * 1.1_f64.powi(n)).collect();
    assert_eq!(known(&slow), slow.iter().copied().map(Some).collect::<Vec<_>>(), "a slow change at once");
}

#[test]
fn a_first_frame_that_was_bad_is_corrected() {
    assert_eq!(known(&[1.1, 3.9, 3.9, 4.0]).last(), Some(&Some(4.0)));
}

#[test]
fn odd_frames_that_do_not_agree_are_never_believed() {
    let odd: Vec<f64> = (0..30).map(|n| if n % 2 == 0 { 1.2 } else { 12.0 }).collect();
    assert_eq!(known(&[[4.0].as_slice(), &odd].concat()).last(), Some(&Some(4.0)));
}

#[test]
fn what_is_not_sure_is_not_believed() {
    let mut widths = Widths::default();
    assert!(widths.observe(4.0, Some(1.5)).is_empty() && widths.known_px().is_none());
    assert_eq!(widths.observe(4.0, Some(0.5)), [4.0]);
}

#[test]
fn the_frames_that_were_waited_for_are_handed_on_in_their_order() {
    let mut widths = Widths::default();
    let found: Vec<Vec<f64>> = [4.0, 8.0, 8.1, 8.2].iter().map(|width| widths.observe(*width, None)).collect();
    assert_eq!(found, [vec![4.0], vec![], vec![], vec![8.0, 8.1, 8.2]]);
}
