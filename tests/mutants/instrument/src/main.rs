//! Puts mutants behind a switch at run time. `mutants.py` starts it, in one of two modes:
//!
//! - `instrument describe TREE PLAN OUT` writes for each mutant the text that it changes, and why it is refused;
//! - `instrument apply TREE PLAN OUT` rewrites the files, and writes for each file the byte ranges of each mutant.
//!
//! PLAN is JSON: `files` has for each path a list of mutants (`id`, `genre`, `line`, `col`, `replacement`), `sources`
//! the paths of all Rust sources, `keep_const` names of functions that must stay constant, `needed` what `describe`
//! found of these.

mod const_functions;
mod mutant_finder;
mod source_writer;

use std::collections::{BTreeSet, HashMap};
use std::path::Path;

use const_functions::{NeededConst, StripConst};
use mutant_finder::Finder;
use serde_json::{Value, json};
use source_writer::{Output, nest};
use syn::visit::Visit;

type Id = u32;
type Failure = Box<dyn std::error::Error>;

fn main() -> Result<(), Failure> {
    let words: Vec<String> = std::env::args().collect();
    let [_, mode, tree, plan, out] = words.as_slice() else {
        return Err("instrument describe|apply TREE PLAN OUT".into());
    };
    let tree = Path::new(tree);
    let plan: Value = serde_json::from_str(&std::fs::read_to_string(plan)?)?;
    let mut names = NeededConst::default();
    // Known from `describe`, else found out.
    names
        .needed
        .extend(plan["needed"].as_array().into_iter().flatten().filter_map(|name| name.as_str().map(str::to_owned)));
    for path in plan["sources"].as_array().filter(|_| names.needed.is_empty()).into_iter().flatten() {
        let text = std::fs::read_to_string(tree.join(path.as_str().unwrap_or_default()))?;
        if let Ok(file) = syn::parse_file(&text) {
            names.visit_file(&file);
        }
    }
    for name in plan["keep_const"].as_array().into_iter().flatten() {
        names.needed.insert(name.as_str().unwrap_or_default().to_owned());
    }
    let needed = names.closure();
    let mut answer = serde_json::Map::new();
    let mut described = serde_json::Map::new();
    let empty = Vec::new();
    let files = plan["files"].as_object().ok_or("no files")?;
    for (path, mutants) in files {
        let text = std::fs::read_to_string(tree.join(path))?;
        let file = syn::parse_file(&text).map_err(|error| format!("{path}: {error}"))?;
        let mut by_place: HashMap<(String, usize, usize), Vec<(Id, String)>> = HashMap::new();
        for one in mutants.as_array().unwrap_or(&empty) {
            let key = (
                one["genre"].as_str().unwrap_or_default().to_owned(),
                one["line"].as_u64().unwrap_or(0) as usize,
                one["col"].as_u64().unwrap_or(0) as usize,
            );
            let replacement = one["replacement"].as_str().unwrap_or_default().to_owned();
            by_place.entry(key).or_default().push((one["id"].as_u64().unwrap_or(0) as Id, replacement));
        }
        let mut finder = Finder {
            text: &text,
            by_place,
            context: vec![None],
            edits: vec![],
            reasons: HashMap::new(),
            texts: HashMap::new(),
            functions: vec![],
            needed: &needed,
            matched: BTreeSet::new(),
        };
        finder.visit_file(&file);
        for one in mutants.as_array().unwrap_or(&empty) {
            let id = one["id"].as_u64().unwrap_or(0) as Id;
            let reason = if finder.matched.contains(&id) {
                finder.reasons.get(&id).cloned()
            } else {
                Some("not found".to_owned())
            };
            described.insert(id.to_string(), json!({"text": finder.texts.get(&id), "reason": reason}));
        }
        if mode == "apply" {
            finder.edits.sort_by_key(|edit| {
                (edit.range.start, !edit.range.is_empty(), usize::MAX - edit.range.end, edit.rank())
            });
            let mut output = Output::default();
            let edits = nest(std::mem::take(&mut finder.edits));
            output.render(&text, 0..text.len(), &edits);
            std::fs::write(tree.join(path), &output.text)?;
            let spans: Vec<Value> =
                output.spans.iter().map(|(id, kind, range)| json!([id, kind, range.start, range.end])).collect();
            answer.insert(path.clone(), json!(spans));
        }
    }
    if mode == "apply" {
        // `const` goes where no constant needs it, because the switch is not constant. In files without mutants, too: a
        // constant function may call another.
        for path in plan["sources"].as_array().into_iter().flatten() {
            let path = path.as_str().unwrap_or_default();
            let text = std::fs::read_to_string(tree.join(path))?;
            if !text.contains("const fn") && !text.contains("const unsafe fn") {
                continue;
            }
            let Ok(file) = syn::parse_file(&text) else { continue };
            let mut strip = StripConst { needed: &needed, ranges: vec![] };
            strip.visit_file(&file);
            if strip.ranges.is_empty() {
                continue;
            }
            let mut bytes = text.into_bytes();
            for range in strip.ranges {
                bytes[range].fill(b' '); // The same length: the ranges above stay true.
            }
            std::fs::write(tree.join(path), bytes)?;
        }
    }
    std::fs::write(out, serde_json::to_string(&json!({"described": described, "spans": answer, "const": needed}))?)?;
    Ok(())
}
