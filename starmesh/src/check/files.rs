//! Checks what a configuration needs except itself: files that it names, folders that are written to, addresses of this
//! host.

use std::fs;
use std::io::{ErrorKind, Read as _, Write as _};
use std::net::{SocketAddr, TcpListener};
use std::path::{Path, PathBuf};

use config::Observatory;
use config::header::HeaderTable;
use contract::observatory::Severity;
use node_archive::name::Namer;
use schedule::validate;

/// The severity, the key, and the finding.
type FileFinding = (Severity, String, String);

/// The faults of the files, and their content in words; `names_schedule`: the configuration itself names its schedule.
pub fn look(config: &Observatory, names_schedule: bool) -> (Vec<FileFinding>, Vec<String>) {
    let mut look = Look { found: Vec::new(), held: Vec::new() };
    look.folders(config);
    look.schedule(&config.schedule.file, names_schedule);
    look.archive(config);
    look.observatory(config);
    look.alerts(config);
    look.deliveries(config);
    look.addresses(config);
    look.web(&config.web);
    (look.found, look.held)
}

struct Look {
    found: Vec<FileFinding>,
    held: Vec<String>,
}

impl Look {
    fn error(&mut self, key: &str, what: String) {
        self.found.push((Severity::Error, key.to_owned(), format!("{key}: {what}")));
    }

    fn warning(&mut self, key: &str, what: String) {
        self.found.push((Severity::Warning, key.to_owned(), format!("{key}: {what}")));
    }

    fn folders(&mut self, config: &Observatory) {
        for (key, folder) in [("folders.data", &config.folders.data), ("folders.images", &config.folders.images)] {
            if let Err(why) = writable(folder) {
                self.error(key, why);
            }
        }
        let database = &config.archive.database;
        if let Err(why) = database_file(database) {
            self.error("archive.database", why);
        } else if let Err(why) = database.parent().map_or(Ok(()), writable) {
            self.error("archive.database", why);
        }
    }

    /// A schedule may come later, by `starmesh schedule put`; a misspelled name would wait for it all night.
    fn schedule(&mut self, file: &Path, is_named: bool) {
        let shown = file.display();
        if file.is_dir() {
            self.error("schedule.file", format!("{shown} is a folder; name a file, such as schedule.jsonl"));
        }
        if file.exists() || !is_named {
            return;
        }
        let neighbors = file.parent().and_then(|folder| fs::read_dir(folder).ok()).into_iter().flatten().flatten();
        let names: Vec<String> = neighbors
            .filter_map(|entry| entry.file_name().into_string().ok())
            .filter(|name| name.ends_with(".jsonl"))
            .collect();
        let name = file.file_name().unwrap_or_default().to_string_lossy();
        let meant = config::nearest(&name, names.iter().map(String::as_str));
        let meant = meant.map_or(String::new(), |near| format!("; did you mean \"{near}\"?"));
        self.warning(
            "schedule.file",
            format!("there is no file {shown}: nothing is observed until it is there{meant}"),
        );
    }

    fn archive(&mut self, config: &Observatory) {
        let (_, wrong) =
            Namer::with_faults(&config.archive.filename, config.archive.profile, config.place.longitude_deg);
        for fault in wrong {
            let key = format!("archive.filename.{}", fault.action);
            self.found.push((Severity::Error, key, fault.to_string()));
        }
        let read = match &config.archive.fits_header {
            None => Ok(HeaderTable::default()),
            Some(csv) => text(csv)
                .and_then(|text| text.parse::<HeaderTable>().map_err(|error| format!("{}: {error}", csv.display()))),
        };
        match read {
            Err(why) => self.error("archive.fits_header", why),
            Ok(table) => {
                if config.archive.fits_header.is_some() {
                    for note in node_archive::header::check(&table) {
                        self.warning("archive.fits_header", format!("{note}; this row is left out"));
                    }
                }
                self.held.push(format!("{} rows in the FITS-header table", table.rows.len()));
            }
        }
    }

    /// A destination may be away by day: what cannot be used now is something to know.
    fn deliveries(&mut self, config: &Observatory) {
        for (index, delivery) in config.delivery.iter().enumerate() {
            let name = &delivery.name;
            let mut warn = |key: &str, what: String| {
                let key = format!("delivery[{index}].{key}");
                self.found.push((Severity::Warning, key, format!("delivery \"{name}\": {what}")));
            };
            if let Some(folder) = delivery.directory.as_ref().filter(|folder| !folder.is_dir()) {
                let shown = folder.display();
                warn(
                    "directory",
                    format!("there is no folder {shown}: make it, or mount the share, before the night ends"),
                );
            }
            for (key, file) in [("secret_file", &delivery.secret_file), ("ssh_config", &delivery.ssh_config)] {
                if let Some(Err(why)) = file.as_ref().map(fs::File::open) {
                    let shown = file.as_deref().unwrap_or(Path::new("")).display();
                    warn(key, format!("{key}: {shown} cannot be read ({why}): nothing is delivered without it"));
                }
            }
        }
    }

    fn observatory(&mut self, config: &Observatory) {
        match node_observatory::star_catalogue::open(&config.imaging) {
            Err(why) => self.error("imaging.catalogue", format!("{why:#}")),
            Ok(catalogue) => self.held.push(match (&config.imaging.catalogue, catalogue.stars()) {
                (None, _) => "the star catalogue that is shipped".to_owned(),
                (Some(file), Some(stars)) => format!("star catalogue {}: {stars} stars", file.display()),
                (Some(file), None) => format!("star catalogue {}", file.display()),
            }),
        }
        for (index, mount) in config.telescope.iter().enumerate() {
            // Points in the configuration itself are checked already.
            let file = mount.horizon.as_ref().filter(|source| matches!(source, config::HorizonSource::File(_)));
            if let Some(Err(why)) = file.map(validate::horizon) {
                let (key, name) = (format!("telescope[{index}].horizon"), &mount.common.name);
                self.found.push((Severity::Error, key, format!("telescope \"{name}\": horizon: {why}")));
            }
        }
        if let Some(file) = &config.hooks.script {
            match text(file)
                .and_then(|_| node_observatory::hooks::Script::read(file).map_err(|error| error.to_string()))
            {
                Err(why) => self.error("hooks.script", why),
                Ok(script) => {
                    self.held.push(format!("the site's script {}: {}", file.display(), script.names().join(", ")));
                }
            }
        }
    }

    fn alerts(&mut self, config: &Observatory) {
        let alerts = &config.alerts;
        for (index, hook) in alerts.webhook.iter().enumerate() {
            let key = |last: &str| format!("alerts.webhook[{index}].{last}");
            self.url(&key("url"), &hook.url);
            self.secret(&key("token_file"), hook.token_file.as_deref());
            self.variable(&key("token_env"), hook.token_env.as_deref());
        }
        if let Some(ping) = &alerts.ping {
            self.url("alerts.ping.url", &ping.url);
        }
        if let Some(smtp) = &alerts.smtp {
            self.secret("alerts.smtp.password_file", smtp.password_file.as_deref());
            self.variable("alerts.smtp.password_env", smtp.password_env.as_deref());
        }
        if let Some(file) = &alerts.ca_file {
            match text(file) {
                Err(why) => self.error("alerts.ca_file", why),
                Ok(pem) if !pem.contains("-----BEGIN CERTIFICATE-----") => {
                    let shown = file.display();
                    self.error("alerts.ca_file", format!("{shown} holds no certificate: expected PEM text"));
                }
                Ok(_) => {}
            }
        }
        self.url("names.sesame_url", &config.names.sesame_url);
        self.url("names.horizons_url", &config.names.horizons_url);
    }

    fn url(&mut self, key: &str, url: &str) {
        // A URL that is not of this form is reported already.
        if !url.starts_with("http") || url.contains(char::is_whitespace) {
            return;
        }
        if let Err(why) = reqwest::Url::parse(url) {
            // The URL itself may be a secret.
            self.error(key, format!("this is no address of the web: {why}"));
        }
    }

    fn secret(&mut self, key: &str, file: Option<&Path>) {
        match file.map(text) {
            Some(Err(why)) => self.error(key, why),
            Some(Ok(secret)) if secret.trim().is_empty() => {
                let shown = file.unwrap_or(Path::new("")).display();
                self.error(key, format!("{shown} is empty: expected the secret on its first line"));
            }
            _ => {}
        }
    }

    fn variable(&mut self, key: &str, name: Option<&str>) {
        if let Some(name) = name.filter(|name| std::env::var_os(name).is_none()) {
            self.warning(key, format!("the environment variable {name} is not set here; the nodes need it"));
        }
    }

    fn addresses(&mut self, config: &Observatory) {
        self.listens("web.listen", config.web.listen);
        // The nodes of all files of a host share that one.
        let own =
            config.bus.listen.iter().enumerate().filter(|(_, endpoint)| *endpoint != config::endpoints::THIS_HOST);
        for (index, endpoint) in own {
            if let Some(address) = endpoint.strip_prefix("tcp/").and_then(|address| address.parse().ok()) {
                self.listens(&format!("bus.listen[{index}]"), address);
            }
        }
        if !config.camera.is_empty() {
            self.listens("spool.listen", config.spool.listen);
        }
    }

    /// The users and the certificate, by the functions of the web node.
    fn web(&mut self, web: &config::Web) {
        let shown = web.users.display();
        match users::read(&web.users) {
            Err(why) => return self.error("web.users", why.to_string()),
            Ok(None) if web.insecure_open => {
                let what = format!(
                    "everybody who reaches {} may open the dome; users are made by `starmesh user add`",
                    web.listen
                );
                self.warning("web.insecure_open", what);
            }
            Ok(None) => {}
            Ok(Some(users)) => {
                self.held.push(format!("{} users and {} tokens in {shown}", users.users.len(), users.tokens.len()));
                if web.insecure_open {
                    self.warning(
                        "web.insecure_open",
                        "there are users, so that it has no effect; leave it away".to_owned(),
                    );
                }
                if node::private::is_open_to_others(&web.users) {
                    self.warning(
                        "web.users",
                        format!("{shown} may be read by others: correct that with `chmod 600 {shown}`"),
                    );
                }
            }
        }
        let known = node_web::readable_paths();
        for path in &web.public {
            let fits = |pattern: &&str| {
                let (words, wanted) = (path.split('/'), pattern.split('/'));
                words.clone().count() == wanted.clone().count()
                    && words
                        .zip(wanted)
                        .all(|(word, wanted)| word == wanted || (wanted.starts_with('{') && !word.is_empty()))
            };
            if !known.iter().any(fits) {
                let plain = known.iter().copied().filter(|pattern| !pattern.contains('{'));
                let plain: Vec<&str> = plain.collect();
                let meant = schedule::meant(path, plain.iter().copied());
                self.warning("web.public", format!("nothing is answered at {path:?}; {meant}"));
            }
        }
        let served = node_web::may_listen(web).and_then(|()| match node_web::CertificateFiles::of(web) {
            Some(files) => files.read().map(drop),
            None => Ok(()),
        });
        if let Err(why) = served {
            // It begins with its key.
            let key = why.split([' ', ':']).next().unwrap_or_default().to_owned();
            self.found.push((Severity::Error, key, why));
        }
    }

    /// Only a warning: the file may be for another host, and the nodes may be running.
    fn listens(&mut self, key: &str, address: SocketAddr) {
        let Err(error) = TcpListener::bind(address) else { return };
        let why = match error.kind() {
            ErrorKind::AddrInUse => {
                format!("port {} is taken at the moment; unless by a node of this file, choose another", address.port())
            }
            ErrorKind::AddrNotAvailable => format!("{} is no address of this host", address.ip()),
            ErrorKind::PermissionDenied => {
                format!("this user may not serve on port {}; choose one from 1024 on", address.port())
            }
            _ => error.to_string(),
        };
        self.warning(key, why);
    }
}

fn text(file: &Path) -> Result<String, String> {
    let shown = file.display();
    let bytes = fs::read(file).map_err(|error| match error.kind() {
        ErrorKind::NotFound => format!("there is no file {shown}"),
        _ if file.is_dir() => format!("{shown} is a folder; name a file"),
        _ => format!("cannot read {shown}: {error}"),
    })?;
    config::utf8(bytes).map_err(|why| format!("{shown}: {why}"))
}

/// Can files be written to this folder, or could it be made? The error says what to do.
pub fn writable(folder: &Path) -> Result<(), String> {
    let shown = folder.display();
    let mut there: PathBuf = folder.to_owned();
    while fs::symlink_metadata(&there).is_err() && there.pop() {}
    if there.as_os_str().is_empty() {
        there.push(".");
    }
    if !there.is_dir() {
        return Err(format!("{} is no folder, so that nothing can be written to {shown}", there.display()));
    }
    // The file has no name, and is gone when it is closed. A full disk makes files, and takes nothing that is written.
    let tried = tempfile::tempfile_in(&there).and_then(|mut file| file.write_all(&[1; 4096]));
    tried.map_err(|error| {
        let (why, what_to_do) = (error.to_string(), what_to_do(error.kind()));
        let why = why.split(" at path").next().unwrap_or_default();
        format!("nothing can be written to {shown}: {why}; {what_to_do}, or choose another folder")
    })
}

/// What to do where nothing can be written.
fn what_to_do(kind: ErrorKind) -> &'static str {
    match kind {
        ErrorKind::StorageFull | ErrorKind::QuotaExceeded => "make room there",
        ErrorKind::ReadOnlyFilesystem => "mount it for writing",
        _ => "give it to the user of the nodes",
    }
}

/// Is this a database of SQLite, or nothing yet?
fn database_file(file: &Path) -> Result<(), String> {
    let shown = file.display();
    if file.is_dir() {
        return Err(format!("{shown} is a folder; name a file, such as data/archive.db"));
    }
    let Ok(mut open) = fs::File::open(file) else { return Ok(()) };
    let mut begin = Vec::new();
    (&mut open).take(16).read_to_end(&mut begin).map_err(|error| format!("cannot read {shown}: {error}"))?;
    if begin.is_empty() || begin.starts_with(b"SQLite format 3") {
        Ok(())
    } else {
        Err(format!("{shown} is no database of SQLite; move it away, or name another file"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_full_disk_one_that_may_only_be_read_and_a_folder_of_somebody_else_need_something_else_each() {
        assert_eq!(what_to_do(ErrorKind::StorageFull), "make room there");
        assert_eq!(what_to_do(ErrorKind::ReadOnlyFilesystem), "mount it for writing");
        assert_eq!(what_to_do(ErrorKind::PermissionDenied), "give it to the user of the nodes");
    }
}
