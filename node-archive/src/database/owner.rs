//! Whose rows they are: telescopes that share a database have their own frames, states and alerts.

/// The addition of version 10: the telescope of each row, and indices by which frames are found. Rows of before belong to the
/// only telescope that the database knows; where it knows several, their telescope is not known and the text is empty.
///
/// Two telescopes may raise the same alert at the same time, so their alerts have the telescope in their key.
pub(super) const SCHEMA: &str = "
ALTER TABLE images ADD COLUMN telescope TEXT NOT NULL DEFAULT '';
ALTER TABLE facts ADD COLUMN telescope TEXT NOT NULL DEFAULT '';
ALTER TABLE focus_runs ADD COLUMN telescope TEXT NOT NULL DEFAULT '';
ALTER TABLE states ADD COLUMN telescope TEXT NOT NULL DEFAULT '';
ALTER TABLE schedule_rows ADD COLUMN telescope TEXT NOT NULL DEFAULT '';
CREATE TABLE own_alerts (
    id TEXT NOT NULL, raised TEXT NOT NULL, priority TEXT NOT NULL, cause TEXT NOT NULL, acknowledged_by TEXT,
    cleared TEXT, last TEXT NOT NULL, boot_id TEXT NOT NULL, seq INTEGER NOT NULL, telescope TEXT NOT NULL,
    PRIMARY KEY (id, raised, telescope)
);
INSERT INTO own_alerts SELECT *, '' FROM alerts;
DROP TABLE alerts;
ALTER TABLE own_alerts RENAME TO alerts;
CREATE INDEX alerts_date ON alerts (raised);
CREATE TEMP TABLE owner AS SELECT DISTINCT telescope FROM
    (SELECT telescope FROM series UNION SELECT telescope FROM guiding) WHERE telescope <> 'shared';
DELETE FROM owner WHERE (SELECT count(*) FROM owner) > 1;
UPDATE images SET telescope = owner.telescope FROM owner;
UPDATE facts SET telescope = owner.telescope FROM owner;
UPDATE focus_runs SET telescope = owner.telescope FROM owner;
UPDATE states SET telescope = owner.telescope FROM owner;
UPDATE schedule_rows SET telescope = owner.telescope FROM owner;
UPDATE alerts SET telescope = owner.telescope FROM owner;
DROP TABLE owner;
CREATE INDEX images_camera ON images (camera_name, date_obs);
CREATE INDEX images_filter ON images (filter, date_obs);
";
