//! The host that a node runs on.

/// This host's name, as its shell, Windows or the Linux kernel reports it; empty if none does.
pub fn host_name() -> String {
    let of_the_shell = std::env::var("HOSTNAME").or_else(|_| std::env::var("COMPUTERNAME"));
    let name = of_the_shell.or_else(|_| std::fs::read_to_string("/proc/sys/kernel/hostname")).unwrap_or_default();
    name.trim().to_owned()
}
