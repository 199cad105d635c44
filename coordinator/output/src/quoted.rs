//! Words of commands that are shown to be copied.

use std::ffi::OsStr;

/// A word as a shell takes it: in quotes, if it has other characters than plain ones.
pub fn quoted(word: impl AsRef<OsStr>) -> String {
    let word = word.as_ref().to_string_lossy();
    let plain = |c: char| c.is_alphanumeric() || "-_=./,:+".contains(c);
    if !word.is_empty() && word.chars().all(plain) {
        word.into_owned()
    } else {
        format!("'{}'", word.replace('\'', "'\\''"))
    }
}

#[cfg(test)]
mod tests {
    use std::process::Command;

    use super::*;

    /// A real shell reads them.
    #[test]
    fn a_shell_reads_what_was_meant() {
        for word in
            ["runs/a", "my runs/a", "it's", "$HOME `ls` \"x\"", "", "a;b&c|d>e*", "\u{e4}\n"]
        {
            let script = format!("printf %s {}", quoted(word));
            let output = Command::new("sh").args(["-c", &script]).output().expect("sh starts");
            assert_eq!(String::from_utf8_lossy(&output.stdout), word, "{script}");
        }
        assert_eq!(quoted("runs/task=1,seed=2"), "runs/task=1,seed=2", "plain words stay so");
    }
}
