//! Credentials stay in the environment. What servers answer is shown to users and written into logs, and servers repeat
//! what they were sent: the key's name, the text that was signed.

/// Ends of the names of variables that hold what nobody else may read.
const SECRET: [&str; 6] = ["KEY", "KEY_ID", "TOKEN", "SECRET", "SIGNATURE", "PASSWORD"];
/// Shorter values stand in texts by chance.
const SHORTEST: usize = 4;

/// The text without any value of a variable that is a credential.
pub(crate) fn hidden(text: &str) -> String {
    let secrets = std::env::vars().filter(|(name, value)| {
        SECRET.iter().any(|end| name.to_ascii_uppercase().ends_with(end)) && value.len() >= SHORTEST
    });
    secrets.fold(text.to_owned(), |text, (_, value)| text.replace(&value, "***"))
}
