//! A destination that rsync reaches: over ssh, or a daemon.
//!
//! rsync itself writes under a temporary name and renames. What arrived is read back by `sha256sum` over ssh; where the
//! other side gives no shell, and from a daemon, the files are fetched again and hashed here.

use std::collections::HashSet;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Stdio;
use std::time::Duration;

use anyhow::{Context as _, anyhow, bail, ensure};
use tokio::io::AsyncWriteExt as _;
use tokio::process::Command;

use super::directory::PART_FOLDER;
use super::hash::hash_file;
use super::item::{Holdings, Item, MOST_BYTES, is_this_machine, short_text, taken, too_large};
use super::manifest::Held;
use super::record::{FETCHED_FOLDER, SENT_FOLDER};

/// rsync ends when nothing moves for so long, s.
const SILENT_S: u32 = 120;
/// A command on the other side ends within this, plus what reading so many bytes takes at this rate.
const SHELL_TIMEOUT: Duration = Duration::from_secs(180);
const SLOWEST_BYTES_PER_S: u64 = 1_000_000;
/// No batch of files takes longer than this.
const LONGEST: Duration = Duration::from_secs(6 * 3600);
/// Lines of what a program complains of that are quoted.
const QUOTED: usize = 3;
/// Asks for the hash of each name that it reads, after the folder; it runs in any shell that ssh may find there.
const HASHES: &str = "sh -c 'IFS= read -r f; cd -- \"$f\" 2>/dev/null || { echo nofolder; exit 0; }; \
     while IFS= read -r n; do if [ -f \"$n\" ]; then s=$(wc -c < \"$n\") && h=$(sha256sum < \"$n\") && \
     echo held $s $h || echo unreadable; elif [ -e \"$n\" ]; then echo other; else echo absent; fi; done; echo end'";
/// Gives names to parts, of which it reads pairs: a link takes no name that is taken; where the disk there knows no links,
/// `mv -n` is the next best.
const GIVE_NAMES: &str = "sh -c 'IFS= read -r f; cd -- \"$f\" || exit 1; while IFS= read -r p && IFS= read -r n; do \
     mkdir -p -- \"${n%/*}\" || exit 1; \
     if ln -- \"$p\" \"$n\" 2>/dev/null; then rm -f -- \"$p\"; echo named; \
     elif [ -e \"$n\" ] || [ -L \"$n\" ]; then echo \"taken $n\"; \
     elif mv -n -- \"$p\" \"$n\" && [ ! -e \"$p\" ]; then echo named; fi; rmdir -- \"${p%/*}\" 2>/dev/null; done; exit 0'";
/// Prints [`node::kernel_boot_id`] of the other side.
const THEIR_BOOT_ID: &str = "cat /proc/sys/kernel/random/boot_id";
const REMOVE: &str = "sh -c 'IFS= read -r f; cd -- \"$f\" && while IFS= read -r n; do rm -f -- \"$n\"; done'";

/// A folder that rsync reaches.
#[derive(Debug)]
pub struct Rsync {
    /// `user@host:/folder` or `rsync://host/module/folder`.
    pub place: String,
    /// The configuration of ssh.
    pub ssh_config: Option<PathBuf>,
    /// The password of a daemon.
    pub password: Option<String>,
    /// A folder for copies here.
    pub work: PathBuf,
}

impl Rsync {
    /// Host and folder, where it is reached by ssh.
    fn by_ssh(&self) -> Option<(&str, &str)> {
        if self.place.starts_with("rsync://") { None } else { self.place.split_once(':') }
    }

    fn ssh(&self) -> Vec<String> {
        let mut words: Vec<String> =
            ["ssh", "-o", "BatchMode=yes", "-o", "ConnectTimeout=20", "-o", "ServerAliveInterval=20"]
                .map(str::to_owned)
                .to_vec();
        if let Some(file) = &self.ssh_config {
            words.extend(["-F".to_owned(), file.display().to_string()]);
        }
        words
    }

    fn rsync(&self) -> Command {
        let mut command = Command::new("rsync");
        command.args(["--times", "--protect-args", &format!("--timeout={SILENT_S}"), "--files-from=-"]);
        if self.by_ssh().is_some() {
            let words: Vec<String> = self.ssh().iter().map(|word| quoted(word)).collect();
            command.arg("--rsh").arg(words.join(" "));
        } else {
            command.arg("--contimeout=20");
            // The environment of a process is not shown to other users, unlike its arguments.
            command.env("RSYNC_PASSWORD", self.password.as_deref().unwrap_or_default());
        }
        command
    }

    /// The place with a `/` at its end: what is below it.
    fn below(&self) -> String {
        format!("{}/", self.place.trim_end_matches('/'))
    }

    /// Is the other side this machine?
    pub async fn is_here(&self) -> anyhow::Result<bool> {
        let Some((host, folder)) = self.by_ssh() else {
            let host = self.place.trim_start_matches("rsync://").split('/').next().unwrap_or_default();
            let host = host.rsplit_once('@').map_or(host, |(_, host)| host);
            let host = host.rsplit_once(':').map_or(host, |(name, _)| name);
            return Ok(is_this_machine(host.trim_matches(['[', ']'])));
        };
        // An alias of ssh may lead anywhere; a machine that runs has an id of its own.
        let own = node::kernel_boot_id();
        let done = self.shell(host, folder, THEIR_BOOT_ID, &[], 0).await?;
        let is_same = !own.is_empty() && String::from_utf8_lossy(&done.stdout).contains(&own);
        Ok(is_same || is_this_machine(host.rsplit_once('@').map_or(host, |(_, host)| host)))
    }

    /// Proves that the other side answers and that the folder is there, as far as it gives a shell.
    pub async fn check(&self) -> anyhow::Result<()> {
        self.asked_hashes(&[], 0).await.map(|_| ())
    }

    /// Reads files back; `bytes` is their size.
    pub async fn held(&self, names: &[String], bytes: u64) -> anyhow::Result<Holdings> {
        if self.by_ssh().is_some()
            && let Some(holdings) = self.asked_hashes(names, bytes).await?
        {
            return Ok(holdings);
        }
        let folder = self.fetch(names).await?;
        let (root, names) = (folder.path().to_owned(), names.to_vec());
        let look = move || -> anyhow::Result<Holdings> {
            let mut holdings = Holdings::new();
            for name in names {
                let path = root.join(&name);
                if path.is_file() {
                    let held = hash_file(&path).with_context(|| format!("cannot read {}", path.display()))?;
                    holdings.insert(name, held);
                }
            }
            Ok(holdings)
        };
        let found = tokio::task::spawn_blocking(look).await?;
        drop(folder);
        found
    }

    /// The hashes that the other side computes; absent where it gives no shell.
    async fn asked_hashes(&self, names: &[String], bytes: u64) -> anyhow::Result<Option<Holdings>> {
        let Some((host, folder)) = self.by_ssh() else { return Ok(None) };
        let done = self.shell(host, folder, HASHES, names, bytes).await?;
        let text = String::from_utf8_lossy(&done.stdout).into_owned();
        let mut lines = text.lines().skip_while(|line| !is_answer(line));
        if lines.clone().next() == Some("nofolder") {
            bail!("the folder {folder} does not exist on {host}: make it there");
        }
        if done.status.code() == Some(255) {
            bail!("{}", complaint("ssh", &self.place, &done));
        }
        let mut holdings = Holdings::new();
        for name in names {
            let words: Vec<&str> = lines.next().unwrap_or_default().split_whitespace().collect();
            match words.as_slice() {
                ["held", bytes, sha256, ..] if sha256.len() == 64 => {
                    let held = Held { bytes: bytes.parse()?, sha256: sha256.to_ascii_lowercase() };
                    holdings.insert(name.clone(), held);
                }
                ["absent"] => {}
                ["unreadable"] => {
                    bail!("{host} cannot read {name} in {folder}, or has no sha256sum: look at the rights of the file")
                }
                ["other"] => drop(holdings.insert(name.clone(), Held::foreign())),
                _ => return Ok(None),
            }
        }
        // Without its end the answer broke off.
        Ok((lines.next() == Some("end")).then_some(holdings))
    }

    async fn shell(
        &self,
        host: &str,
        folder: &str,
        script: &str,
        names: &[String],
        bytes: u64,
    ) -> anyhow::Result<std::process::Output> {
        let words = self.ssh();
        let mut command = Command::new("ssh");
        command.args(&words[1..]).arg("--").arg(host).arg(script);
        let mut text = format!("{folder}\n");
        names.iter().for_each(|name| text.push_str(&format!("{name}\n")));
        run("ssh", command, text, SHELL_TIMEOUT + Duration::from_secs(bytes / SLOWEST_BYTES_PER_S)).await
    }

    /// Copies files from there into a new folder here.
    async fn fetch(&self, names: &[String]) -> anyhow::Result<tempfile::TempDir> {
        let folder = self.work_folder(FETCHED_FOLDER)?;
        let mut command = self.rsync();
        command.arg("--ignore-missing-args").arg(self.below()).arg(folder.path());
        let done = run("rsync", command, lines(names), LONGEST).await?;
        ensure!(done.status.success(), "{}", complaint("rsync", &self.place, &done));
        Ok(folder)
    }

    fn work_folder(&self, begins: &str) -> anyhow::Result<tempfile::TempDir> {
        let made = node::private::make_folder(&self.work)
            .and_then(|()| tempfile::Builder::new().prefix(begins).tempdir_in(&self.work));
        made.with_context(|| format!("cannot make a folder in {}", self.work.display()))
    }

    /// The content of a small file that may be there.
    pub async fn read(&self, name: &str) -> anyhow::Result<Option<Vec<u8>>> {
        let folder = self.fetch(&[name.to_owned()]).await?;
        let path = folder.path().join(name);
        if !path.is_file() {
            return Ok(None);
        }
        ensure!(fs::metadata(&path)?.len() <= MOST_BYTES, "{}", too_large(name));
        Ok(Some(fs::read(path)?))
    }

    /// Sends files to names that nothing has, and returns what was read back.
    pub async fn send(&self, items: &[Item]) -> anyhow::Result<Holdings> {
        let folder = self.work_folder(SENT_FOLDER)?;
        // With a shell there, files get their names as in a folder: where nothing has them.
        let shell = if self.asked_hashes(&[], 0).await?.is_some() { self.by_ssh() } else { None };
        let sent_as = |item: &Item| if shell.is_some() { part_name(&item.name) } else { item.name.clone() };
        let (root, copied) =
            (folder.path().to_owned(), items.iter().map(|item| (sent_as(item), item.clone())).collect::<Vec<_>>());
        // A header can be completed while rsync reads the file; a copy does not change, and its hash shows the change.
        tokio::task::spawn_blocking(move || copied.iter().try_for_each(|(name, item)| copy(&root, name, &item.file)))
            .await??;
        let names: Vec<String> = items.iter().map(sent_as).collect();
        let mut command = self.rsync();
        command.arg("--out-format=%n");
        // A part of ours is taken up again; a name is left alone where something has it.
        command.args(if shell.is_some() {
            ["--partial", "--inplace"]
        } else {
            ["--ignore-existing", "--partial-dir=.starmesh-part"]
        });
        // Copies here are private; new files and folders there are as public as the other side's umask lets them be, and
        // those that are there stay as they are.
        command.arg("--chmod=D755,F644");
        command.arg(format!("{}/", folder.path().display())).arg(self.below());
        let done = run("rsync", command, lines(&names), LONGEST).await?;
        ensure!(done.status.success(), "{}", complaint("rsync", &self.place, &done));
        drop(folder);
        let bytes = items.iter().map(|item| item.bytes).sum();
        if let Some((host, there)) = shell {
            return self.give_names(host, there, items, bytes).await;
        }
        let holdings = self.held(&names, bytes).await?;
        let output = String::from_utf8_lossy(&done.stdout).into_owned();
        let ours: HashSet<&str> = output.lines().collect();
        for item in items.iter().filter(|item| !ours.contains(item.name.as_str())) {
            let is_same = holdings.get(&item.name).is_none_or(|held| held.sha256 == item.sha256);
            ensure!(is_same, "{}", taken(&item.name));
        }
        Ok(holdings)
    }

    /// Hashes what arrived under the names of parts, and gives each whole one its name, where nothing has it.
    async fn give_names(&self, host: &str, there: &str, items: &[Item], bytes: u64) -> anyhow::Result<Holdings> {
        let parts: Vec<String> = items.iter().map(|item| part_name(&item.name)).collect();
        let arrived = self.held(&parts, bytes).await?;
        let (mut holdings, mut pairs) = (Holdings::new(), Vec::new());
        for (item, part) in items.iter().zip(&parts) {
            let Some(held) = arrived.get(part) else { continue };
            holdings.insert(item.name.clone(), held.clone());
            if held.sha256 == item.sha256 {
                pairs.extend([part.clone(), item.name.clone()]);
            } else {
                self.shell(host, there, REMOVE, std::slice::from_ref(part), 0).await?;
            }
        }
        let done = self.shell(host, there, GIVE_NAMES, &pairs, 0).await?;
        ensure!(done.status.success(), "{}", complaint("ssh", &self.place, &done));
        let text = String::from_utf8_lossy(&done.stdout).into_owned();
        let named = text.lines().filter(|line| *line == "named").count();
        if let Some(name) = text.lines().find_map(|line| line.strip_prefix("taken ")) {
            bail!("{}", taken(name));
        }
        ensure!(
            named * 2 == pairs.len(),
            "{host} gave no names to {} files: look at the rights of the folder",
            pairs.len() / 2 - named
        );
        Ok(holdings)
    }

    /// Removes a file that was sent a moment ago and is not there as it was sent.
    pub async fn discard(&self, name: &str) -> anyhow::Result<()> {
        if self.asked_hashes(&[], 0).await?.is_some() {
            // It never got its name.
            return Ok(());
        }
        bail!("remove {name} in {}: it gives no shell by which that could be done from here", self.place)
    }
}

/// A login script may print something before the answer.
fn is_answer(line: &str) -> bool {
    ["held", "absent", "nofolder", "unreadable", "other", "end"].contains(&line.split(' ').next().unwrap_or_default())
}

/// The name that a file has there until it is whole; each telescope has its own folder of them.
fn part_name(name: &str) -> String {
    let telescope: Vec<&str> = name.split('/').take(2).collect();
    format!("{}/{PART_FOLDER}/{}", telescope.join("/"), name.replace('/', "_"))
}

fn copy(root: &Path, name: &str, file: &Path) -> anyhow::Result<()> {
    let copy = root.join(name);
    let cannot = || format!("cannot copy {} to {}", file.display(), root.display());
    fs::create_dir_all(copy.parent().unwrap_or(root)).with_context(cannot)?;
    fs::copy(file, &copy).with_context(cannot)?;
    Ok(())
}

fn lines(names: &[String]) -> String {
    names.iter().map(|name| format!("{name}\n")).collect()
}

/// A word as rsync takes it apart in its option `--rsh`.
fn quoted(word: &str) -> String {
    if word.contains([' ', '\'', '"']) { format!("\"{}\"", word.replace('"', "\"\"")) } else { word.to_owned() }
}

async fn run(
    program: &str,
    mut command: Command,
    input: String,
    most: Duration,
) -> anyhow::Result<std::process::Output> {
    command.stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped()).kill_on_drop(true);
    // Messages are read by a program.
    command.env("LC_ALL", "C");
    let mut child = command.spawn().with_context(|| {
        format!("cannot run {program}: install it, such as with apt-get install rsync openssh-client")
    })?;
    let mut stdin = child.stdin.take().ok_or_else(|| anyhow!("{program} takes no input"))?;
    let write = async move {
        // A program that has ended takes no more; its complaint is reported.
        let _ = stdin.write_all(input.as_bytes()).await;
    };
    let both = async { tokio::join!(write, child.wait_with_output()).1 };
    let done = tokio::time::timeout(most, both).await;
    done.with_context(|| {
        format!("{program} did not end within {} s: look at the other side and the network", most.as_secs())
    })?
    .with_context(|| format!("{program} cannot be waited for"))
}

/// What a program complained of, and what to do.
fn complaint(program: &str, place: &str, done: &std::process::Output) -> String {
    let text = String::from_utf8_lossy(&done.stderr);
    let lines: Vec<&str> = text.lines().map(str::trim).filter(|line| !line.is_empty()).take(QUOTED).collect();
    let advice = match done.status.code() {
        _ if text.contains("No space left") || text.contains("quota") => "free the disk there",
        _ if text.contains("Read-only") || text.contains("read only") || text.contains("Permission denied (13)") => {
            "let this user write there"
        }
        Some(255) => "look at the network, the key of ssh and known_hosts: ssh to it by hand, as this user",
        Some(5) if text.contains("auth") => "look at its user and secret_file",
        Some(10 | 12 | 30 | 35) => "look at the network and at rsync on the other side",
        Some(3 | 11 | 23) => "look whether the folder exists there and this user may write to it",
        _ => "run it by hand to see more",
    };
    format!("{program} to {place} failed ({}): {}; {advice}", done.status, short_text(&lines.join("; ")))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_word_with_a_blank_is_one_word_for_rsync() {
        assert_eq!(quoted("/etc/my site/ssh"), "\"/etc/my site/ssh\"");
        assert_eq!(quoted("-F"), "-F");
    }
}
