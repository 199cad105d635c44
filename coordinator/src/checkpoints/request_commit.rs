//! `commit`: has a live run commit a checkpoint now.

use service::client::Client;
use service::http::Token;

use crate::checkpoints::options::CommitArgs;

/// Asks the run and says what it has committed.
pub(super) fn commit(args: &CommitArgs) -> anyhow::Result<()> {
    let token_file = args.token_file.as_deref();
    let token = token_file.map(Token::from_file).transpose()?;
    let client = Client::of_run(&args.run_dir, token)?;
    let answer = client.checkpoint_now().map_err(|error| error.explained(token_file))?;
    if args.json {
        return output::json(&answer);
    }
    let shown = args.run_dir.display();
    output::line(&match &answer.checkpoint {
        Some(name) => format!("{shown}: committed {name}"),
        None => format!(
            "{shown}: will be committed after the iteration that is being trained on, which is a \
             long one; `octopus checkpoints list {}` shows it then",
            output::quoted(&args.run_dir)
        ),
    })
}
