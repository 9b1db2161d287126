//! Writes a source again with each mutant behind the switch.

use std::ops::Range;

use crate::Id;
use crate::mutant_finder::{Edit, EditKind};

const SWITCH: &str = "::posebridge_mutant_switch::on";

/// Sorted edits as a tree; an insertion has no children.
pub(crate) fn nest(edits: Vec<Edit>) -> Vec<Edit> {
    let mut roots: Vec<Edit> = vec![];
    let mut open: Vec<Edit> = vec![];
    let close = |open: &mut Vec<Edit>, roots: &mut Vec<Edit>| {
        if let Some(done) = open.pop() {
            open.last_mut().map_or(roots, |parent| &mut parent.children).push(done);
        }
    };
    for edit in edits {
        while open.last().is_some_and(|last| last.range.end <= edit.range.start) {
            close(&mut open, &mut roots);
        }
        if edit.range.is_empty() {
            open.last_mut().map_or(&mut roots, |parent| &mut parent.children).push(edit);
        } else {
            open.push(edit);
        }
    }
    while !open.is_empty() {
        close(&mut open, &mut roots);
    }
    roots
}

#[derive(Default)]
pub(crate) struct Output {
    pub(crate) text: String,
    /// Of each mutant: its branch ("m") and all of the expression that it changes ("n").
    pub(crate) spans: Vec<(Id, &'static str, Range<usize>)>,
}

impl Output {
    pub(crate) fn render(&mut self, source: &str, range: Range<usize>, edits: &[Edit]) {
        let mut at = range.start;
        for edit in edits.iter().filter(|edit| range.start <= edit.range.start && edit.range.end <= range.end) {
            self.text.push_str(&source[at..edit.range.start]);
            self.edit(source, edit);
            at = edit.range.end;
        }
        self.text.push_str(&source[at..range.end]);
    }

    pub(crate) fn edit(&mut self, source: &str, edit: &Edit) {
        let begun = self.text.len();
        match &edit.kind {
            EditKind::Fn => {
                for (id, replacement, _) in &edit.mutants {
                    self.branch(*id, &format!("if {SWITCH}({id}) {{ return {replacement}; }} "));
                }
            }
            EditKind::Arm => {
                let on: Vec<String> = edit.mutants.iter().map(|(id, ..)| format!("!{SWITCH}({id})")).collect();
                let text = format!(" if {}", on.join(" && "));
                for (id, ..) in &edit.mutants {
                    self.spans.push((*id, "m", begun..begun + text.len()));
                }
                self.text.push_str(&text);
            }
            EditKind::Guard => {
                self.switch(edit, |_, replacement, _| replacement.to_owned());
                self.render(source, edit.range.clone(), &edit.children);
                self.text.push_str(" })");
            }
            EditKind::Binary { left, operator, right } => {
                let (l, r) = (&source[left.clone()], &source[right.clone()]);
                self.switch(edit, |_, replacement, _| format!("({l}) {replacement} ({r})"));
                self.text.push('(');
                self.render(source, left.clone(), &edit.children);
                self.text.push(')');
                self.text.push_str(&source[left.end..operator.start]);
                self.text.push_str(&source[operator.clone()]);
                self.text.push_str(&source[operator.end..right.start]);
                self.text.push('(');
                self.render(source, right.clone(), &edit.children);
                self.text.push_str(") })");
            }
            EditKind::Unary { operator, operand } => {
                let inner = &source[operand.clone()];
                self.switch(edit, |_, _, _| format!("({inner})"));
                self.text.push_str(&source[operator.clone()]);
                // No parentheses: `-128i8` is one literal with its sign.
                self.render(source, operand.clone(), &edit.children);
                self.text.push_str(" })");
            }
            EditKind::Struct => {
                let all = edit.range.clone();
                self.switch(edit, |_, _, gone| {
                    format!("{}{}", &source[all.start..gone.start], &source[gone.end..all.end])
                });
                self.render(source, edit.range.clone(), &edit.children);
                self.text.push_str(" })");
            }
        }
        let ended = self.text.len();
        for (id, ..) in &edit.mutants {
            self.spans.push((*id, "n", begun..ended));
        }
    }

    pub(crate) fn branch(&mut self, id: Id, text: &str) {
        let from = self.text.len();
        self.text.push_str(text);
        self.spans.push((id, "m", from..self.text.len()));
    }

    /// `(if on(1) { first } else if on(2) { second } else { `; the caller writes the original and closes.
    pub(crate) fn switch(&mut self, edit: &Edit, mutated: impl Fn(Id, &str, Range<usize>) -> String) {
        self.text.push('(');
        for (id, replacement, gone) in &edit.mutants {
            self.branch(*id, &format!("if {SWITCH}({id}) {{ {} }} else ", mutated(*id, replacement, gone.clone())));
        }
        self.text.push_str("{ ");
    }
}
