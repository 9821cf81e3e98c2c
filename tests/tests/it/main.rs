//! End to end: real nodes as processes, the simulated observatory, a private bus; every test ends with a shut roof.

mod alerts_reach_people;
mod archive_away;
mod closes_when_it_rains;
mod closes_when_nodes_die;
mod closes_when_sensors_fail;
mod does_every_action;
mod finds_the_focus;
mod follows_orders;
mod follows_what_moves;
mod goes_on_after_a_restart;
mod leaves_a_record;
mod measures_frames;
mod others_stand_in;
mod plans_the_night;
mod points_where_it_looks;
mod reports_the_night;
mod rows_follow_each_other;
mod spares_the_wait;
mod standby_takes_over;
mod turns_over_at_the_meridian;
mod turns_the_dome;
mod up_supervises;
