//! End to end: real nodes as processes, the simulated observatory, a private bus; every test ends with a shut roof.

mod alerts_reach_people;
mod archive_away;
mod closes_when_it_rains;
mod closes_when_nodes_die;
mod closes_when_sensors_fail;
mod follows_orders;
mod goes_on_after_a_restart;
mod leaves_a_record;
mod spares_the_wait;
mod standby_takes_over;
mod turns_the_dome;
mod up_supervises;
