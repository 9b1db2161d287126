//! Puts mutants behind a switch at run time. `mutants.py` starts it, in one of two modes:
//!
//! - `instrument describe TREE PLAN OUT` writes for each mutant the text that it changes, and why it is refused;
//! - `instrument apply TREE PLAN OUT` rewrites the files, and writes for each file the byte ranges of each mutant.
//!
//! PLAN is JSON: `files` has for each path a list of mutants (`id`, `genre`, `line`, `col`, `replacement`), `sources`
//! the paths of all Rust sources, `keep_const` names of functions that must stay constant, `needed` what `describe`
//! found of these.

use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::ops::Range;
use std::path::Path;

use proc_macro2::{TokenStream, TokenTree};
use quote::ToTokens;
use serde_json::{Value, json};
use syn::spanned::Spanned;
use syn::visit::{self, Visit};
use syn::{BinOp, Expr, UnOp};

type Id = u32;
type Failure = Box<dyn std::error::Error>;
const SWITCH: &str = "::posebridge_mutant_switch::on";

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

// ---- which functions constants need

/// Names that are mentioned where the compiler evaluates, and the bodies of constant functions by name.
#[derive(Default)]
struct NeededConst {
    needed: BTreeSet<String>,
    bodies: BTreeMap<String, BTreeSet<String>>,
}

impl NeededConst {
    fn closure(mut self) -> BTreeSet<String> {
        let mut waiting: Vec<String> = self.needed.iter().cloned().collect();
        while let Some(name) = waiting.pop() {
            for called in self.bodies.get(&name).cloned().unwrap_or_default() {
                if self.needed.insert(called.clone()) {
                    waiting.push(called);
                }
            }
        }
        self.needed
    }
    fn add(&mut self, tokens: TokenStream) {
        identifiers(tokens, &mut self.needed);
    }
    fn body(&mut self, signature: &syn::Signature, block: &syn::Block) {
        if signature.constness.is_some() {
            identifiers(block.to_token_stream(), self.bodies.entry(signature.ident.to_string()).or_default());
        }
    }
}

fn identifiers(tokens: TokenStream, into: &mut BTreeSet<String>) {
    for token in tokens {
        match token {
            TokenTree::Ident(name) => drop(into.insert(name.to_string())),
            TokenTree::Group(group) => identifiers(group.stream(), into),
            _ => {}
        }
    }
}

impl<'a> Visit<'a> for NeededConst {
    fn visit_item_const(&mut self, i: &'a syn::ItemConst) {
        self.add(i.expr.to_token_stream());
        visit::visit_item_const(self, i);
    }
    fn visit_item_static(&mut self, i: &'a syn::ItemStatic) {
        self.add(i.expr.to_token_stream());
        visit::visit_item_static(self, i);
    }
    fn visit_impl_item_const(&mut self, i: &'a syn::ImplItemConst) {
        self.add(i.expr.to_token_stream());
        visit::visit_impl_item_const(self, i);
    }
    fn visit_trait_item_const(&mut self, i: &'a syn::TraitItemConst) {
        if let Some((_, expr)) = &i.default {
            self.add(expr.to_token_stream());
        }
        visit::visit_trait_item_const(self, i);
    }
    fn visit_type_array(&mut self, i: &'a syn::TypeArray) {
        self.add(i.len.to_token_stream());
        visit::visit_type_array(self, i);
    }
    fn visit_expr_repeat(&mut self, i: &'a syn::ExprRepeat) {
        // A constant function's value may be repeated without Copy.
        self.add(i.len.to_token_stream());
        visit::visit_expr_repeat(self, i);
    }
    fn visit_expr_const(&mut self, i: &'a syn::ExprConst) {
        self.add(i.block.to_token_stream());
        visit::visit_expr_const(self, i);
    }
    fn visit_variant(&mut self, i: &'a syn::Variant) {
        if let Some((_, expr)) = &i.discriminant {
            self.add(expr.to_token_stream());
        }
        visit::visit_variant(self, i);
    }
    fn visit_generic_argument(&mut self, i: &'a syn::GenericArgument) {
        if let syn::GenericArgument::Const(expr) = i {
            self.add(expr.to_token_stream());
        }
        visit::visit_generic_argument(self, i);
    }
    fn visit_macro(&mut self, i: &'a syn::Macro) {
        let name = i.path.segments.last().map(|s| s.ident.to_string()).unwrap_or_default();
        let text = i.tokens.to_string();
        if name == "thread_local" || name == "macro_rules" || text.contains("const ") || text.contains("static ") {
            self.add(i.tokens.clone());
        }
    }
    fn visit_item_macro(&mut self, i: &'a syn::ItemMacro) {
        self.add(i.mac.tokens.clone());
    }
    fn visit_item_fn(&mut self, i: &'a syn::ItemFn) {
        self.body(&i.sig, &i.block);
        visit::visit_item_fn(self, i);
    }
    fn visit_impl_item_fn(&mut self, i: &'a syn::ImplItemFn) {
        self.body(&i.sig, &i.block);
        visit::visit_impl_item_fn(self, i);
    }
}

struct StripConst<'n> {
    needed: &'n BTreeSet<String>,
    ranges: Vec<Range<usize>>,
}

impl StripConst<'_> {
    fn signature(&mut self, signature: &syn::Signature) {
        if let Some(word) = &signature.constness
            && !self.needed.contains(&signature.ident.to_string())
        {
            self.ranges.push(word.span.byte_range());
        }
    }
}

impl<'a> Visit<'a> for StripConst<'_> {
    fn visit_item_fn(&mut self, i: &'a syn::ItemFn) {
        self.signature(&i.sig);
        visit::visit_item_fn(self, i);
    }
    fn visit_impl_item_fn(&mut self, i: &'a syn::ImplItemFn) {
        self.signature(&i.sig);
        visit::visit_impl_item_fn(self, i);
    }
}

// ---- where the mutants are

enum Kind {
    Fn,
    Arm,
    Guard,
    Binary { left: Range<usize>, operator: Range<usize>, right: Range<usize> },
    Unary { operator: Range<usize>, operand: Range<usize> },
    Struct,
}

struct Edit {
    range: Range<usize>,
    kind: Kind,
    /// With the replacement, or for a field of a struct the range that goes.
    mutants: Vec<(Id, String, Range<usize>)>,
    children: Vec<Edit>,
}

impl Edit {
    fn rank(&self) -> u8 {
        match self.kind {
            Kind::Fn | Kind::Arm => 0,
            Kind::Guard => 1,
            _ => 2,
        }
    }
}

struct Finder<'a> {
    text: &'a str,
    by_place: HashMap<(String, usize, usize), Vec<(Id, String)>>,
    /// Why nothing here can be instrumented.
    context: Vec<Option<String>>,
    edits: Vec<Edit>,
    reasons: HashMap<Id, String>,
    texts: HashMap<Id, String>,
    functions: Vec<Range<usize>>,
    needed: &'a BTreeSet<String>,
    matched: BTreeSet<Id>,
}

fn squash(text: &str) -> String {
    text.split_whitespace().collect::<Vec<_>>().join(" ")
}

/// A `let` that makes a condition a chain.
fn has_let(expr: &Expr) -> bool {
    match expr {
        Expr::Let(_) => true,
        Expr::Binary(binary) if matches!(binary.op, BinOp::And(_)) => has_let(&binary.left) || has_let(&binary.right),
        _ => false,
    }
}

fn not_built(attrs: &[syn::Attribute]) -> bool {
    attrs.iter().any(|attr| {
        let text = attr.to_token_stream().to_string();
        attr.path().is_ident("cfg")
            && (text.contains("\"png\"") || text.contains("\"bluetooth\""))
            && !text.contains("not")
            && !text.contains("test")
    })
}

fn returns_impl(output: &syn::ReturnType) -> bool {
    struct Look(bool);
    impl<'a> Visit<'a> for Look {
        fn visit_type_impl_trait(&mut self, _: &'a syn::TypeImplTrait) {
            self.0 = true;
        }
    }
    let mut look = Look(false);
    look.visit_return_type(output);
    look.0
}

impl Finder<'_> {
    fn take(&mut self, genre: &str, span: proc_macro2::Span) -> Vec<(Id, String)> {
        let start = span.start();
        let found = self.by_place.remove(&(genre.to_owned(), start.line, start.column + 1)).unwrap_or_default();
        self.matched.extend(found.iter().map(|(id, _)| *id));
        found
    }
    /// Notes the text; true if the place can be instrumented.
    fn note(&mut self, found: &[(Id, String)], text: &str, refusal: Option<&str>) -> bool {
        let reason = refusal.map(str::to_owned).or_else(|| self.context.last().cloned().flatten());
        for (id, _) in found {
            self.texts.insert(*id, squash(text));
            if let Some(reason) = &reason {
                self.reasons.insert(*id, reason.clone());
            }
        }
        !found.is_empty() && reason.is_none()
    }
    fn push(&mut self, range: Range<usize>, kind: Kind, found: Vec<(Id, String)>) {
        let mutants = found.into_iter().map(|(id, replacement)| (id, replacement, 0..0)).collect();
        self.edits.push(Edit { range, kind, mutants, children: vec![] });
    }
    fn within(&mut self, reason: Option<&str>, visit: impl FnOnce(&mut Self)) {
        self.context.push(reason.map(str::to_owned));
        visit(self);
        self.context.pop();
    }
    /// In a constant context unless something worse is known.
    fn constant(&mut self, reason: &str, visit: impl FnOnce(&mut Self)) {
        self.within(Some(reason), visit);
    }
    fn function(
        &mut self,
        signature: &syn::Signature,
        attrs: &[syn::Attribute],
        block: &syn::Block,
        visit: impl FnOnce(&mut Self),
    ) {
        let keeps_const = signature.constness.is_some() && self.needed.contains(&signature.ident.to_string());
        let inherited = self.context.last().cloned().flatten().filter(|reason| reason == "not built");
        let reason = if inherited.is_some() || not_built(attrs) {
            Some("not built")
        } else if keeps_const {
            Some("const fn")
        } else {
            None
        };
        self.within(reason, |this| {
            if let Some(first) = block.stmts.first() {
                let found = this.take("FnValue", first.span());
                let refusal = returns_impl(&signature.output).then_some("returns impl Trait");
                let start = first.span().byte_range().start;
                if this.note(&found, "", refusal) {
                    this.push(start..start, Kind::Fn, found);
                }
            }
            this.functions.push(block.span().byte_range());
            visit(this);
            this.functions.pop();
        });
    }
}

impl<'a> Visit<'a> for Finder<'_> {
    fn visit_item_fn(&mut self, i: &'a syn::ItemFn) {
        self.function(&i.sig, &i.attrs, &i.block, |this| visit::visit_item_fn(this, i));
    }
    fn visit_impl_item_fn(&mut self, i: &'a syn::ImplItemFn) {
        self.function(&i.sig, &i.attrs, &i.block, |this| visit::visit_impl_item_fn(this, i));
    }
    fn visit_trait_item_fn(&mut self, i: &'a syn::TraitItemFn) {
        if let Some(block) = &i.default {
            self.function(&i.sig, &i.attrs, block, |this| visit::visit_trait_item_fn(this, i));
        }
    }
    fn visit_item_mod(&mut self, i: &'a syn::ItemMod) {
        if not_built(&i.attrs) {
            self.within(Some("not built"), |this| visit::visit_item_mod(this, i));
        } else {
            visit::visit_item_mod(self, i);
        }
    }
    fn visit_local(&mut self, i: &'a syn::Local) {
        if not_built(&i.attrs) {
            self.within(Some("not built"), |this| visit::visit_local(this, i));
        } else {
            visit::visit_local(self, i);
        }
    }
    fn visit_item_const(&mut self, i: &'a syn::ItemConst) {
        self.constant("const", |this| visit::visit_item_const(this, i));
    }
    fn visit_item_static(&mut self, i: &'a syn::ItemStatic) {
        self.constant("static", |this| visit::visit_item_static(this, i));
    }
    fn visit_impl_item_const(&mut self, i: &'a syn::ImplItemConst) {
        self.constant("const", |this| visit::visit_impl_item_const(this, i));
    }
    fn visit_trait_item_const(&mut self, i: &'a syn::TraitItemConst) {
        self.constant("const", |this| visit::visit_trait_item_const(this, i));
    }
    fn visit_type_array(&mut self, i: &'a syn::TypeArray) {
        self.constant("array length", |this| visit::visit_type_array(this, i));
    }
    fn visit_variant(&mut self, i: &'a syn::Variant) {
        self.constant("discriminant", |this| visit::visit_variant(this, i));
    }
    fn visit_expr_const(&mut self, i: &'a syn::ExprConst) {
        self.constant("const block", |this| visit::visit_expr_const(this, i));
    }
    fn visit_generic_argument(&mut self, i: &'a syn::GenericArgument) {
        self.constant("generic argument", |this| visit::visit_generic_argument(this, i));
    }
    fn visit_pat(&mut self, i: &'a syn::Pat) {
        self.constant("pattern", |this| visit::visit_pat(this, i));
    }
    fn visit_expr_repeat(&mut self, i: &'a syn::ExprRepeat) {
        self.visit_expr(&i.expr);
        self.constant("array length", |this| this.visit_expr(&i.len));
    }
    fn visit_expr_closure(&mut self, i: &'a syn::ExprClosure) {
        // The body of a closure is never evaluated by the compiler.
        let reason =
            self.context.last().cloned().flatten().filter(|reason| reason == "not built" || reason == "const fn");
        self.within(reason.as_deref(), |this| visit::visit_expr_closure(this, i));
    }

    fn visit_expr_binary(&mut self, i: &'a syn::ExprBinary) {
        let found = self.take("BinaryOperator", i.op.span());
        let (left, right) = (i.left.span().byte_range(), i.right.span().byte_range());
        let refusal = (has_let(&i.left) || has_let(&i.right)).then_some("let chain");
        let text = self.text;
        if self.note(&found, &text[left.start..right.end], refusal) {
            let operator = i.op.span().byte_range();
            self.push(left.start..right.end, Kind::Binary { left, operator, right }, found);
        }
        visit::visit_expr_binary(self, i);
    }
    fn visit_expr_unary(&mut self, i: &'a syn::ExprUnary) {
        if matches!(i.op, UnOp::Not(_) | UnOp::Neg(_)) {
            let found = self.take("UnaryOperator", i.op.span());
            let (operator, operand) = (i.op.span().byte_range(), i.expr.span().byte_range());
            let text = self.text;
            if self.note(&found, &text[operator.start..operand.end], None) {
                self.push(operator.start..operand.end, Kind::Unary { operator, operand }, found);
            }
        }
        visit::visit_expr_unary(self, i);
    }
    fn visit_arm(&mut self, i: &'a syn::Arm) {
        let text = self.text;
        let found = self.take("MatchArm", i.span());
        let pat = i.pat.span().byte_range();
        if self.note(&found, &text[pat.clone()], None) {
            self.push(pat.end..pat.end, Kind::Arm, found);
        }
        if let Some((_, guard)) = &i.guard {
            let found = self.take("MatchArmGuard", guard.span());
            let range = guard.span().byte_range();
            let refusal = has_let(guard).then_some("let guard");
            if self.note(&found, &text[range.clone()], refusal) {
                self.push(range, Kind::Guard, found);
            }
        }
        visit::visit_arm(self, i);
    }
    fn visit_expr_struct(&mut self, i: &'a syn::ExprStruct) {
        if i.rest.is_some() {
            let text = self.text;
            let mut mutants = vec![];
            for pair in i.fields.pairs() {
                let field = pair.value().span();
                let found = self.take("StructField", field);
                let from = field.byte_range().start;
                let to = pair.punct().map_or(field.byte_range().end, |comma| comma.span().byte_range().end);
                let name = format!("{} {}", i.path.to_token_stream(), &text[field.byte_range()]);
                if self.note(&found, &name, None) {
                    mutants.extend(found.into_iter().map(|(id, replacement)| (id, replacement, from..to)));
                }
            }
            if !mutants.is_empty() {
                let from = i
                    .path
                    .span()
                    .byte_range()
                    .start
                    .min(i.qself.as_ref().map_or(usize::MAX, |q| q.lt_token.span.byte_range().start));
                let range = from..i.brace_token.span.close().byte_range().end;
                self.edits.push(Edit { range, kind: Kind::Struct, mutants, children: vec![] });
            }
        }
        visit::visit_expr_struct(self, i);
    }
}

// ---- writing

/// Sorted edits as a tree; an insertion has no children.
fn nest(edits: Vec<Edit>) -> Vec<Edit> {
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
struct Output {
    text: String,
    /// Of each mutant: its branch ("m") and all of the expression that it changes ("n").
    spans: Vec<(Id, &'static str, Range<usize>)>,
}

impl Output {
    fn render(&mut self, source: &str, range: Range<usize>, edits: &[Edit]) {
        let mut at = range.start;
        for edit in edits.iter().filter(|edit| range.start <= edit.range.start && edit.range.end <= range.end) {
            self.text.push_str(&source[at..edit.range.start]);
            self.edit(source, edit);
            at = edit.range.end;
        }
        self.text.push_str(&source[at..range.end]);
    }

    fn edit(&mut self, source: &str, edit: &Edit) {
        let begun = self.text.len();
        match &edit.kind {
            Kind::Fn => {
                for (id, replacement, _) in &edit.mutants {
                    self.branch(*id, &format!("if {SWITCH}({id}) {{ return {replacement}; }} "));
                }
            }
            Kind::Arm => {
                let on: Vec<String> = edit.mutants.iter().map(|(id, ..)| format!("!{SWITCH}({id})")).collect();
                let text = format!(" if {}", on.join(" && "));
                for (id, ..) in &edit.mutants {
                    self.spans.push((*id, "m", begun..begun + text.len()));
                }
                self.text.push_str(&text);
            }
            Kind::Guard => {
                self.switch(edit, |_, replacement, _| replacement.to_owned());
                self.render(source, edit.range.clone(), &edit.children);
                self.text.push_str(" })");
            }
            Kind::Binary { left, operator, right } => {
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
            Kind::Unary { operator, operand } => {
                let inner = &source[operand.clone()];
                self.switch(edit, |_, _, _| format!("({inner})"));
                self.text.push_str(&source[operator.clone()]);
                // No parentheses: `-128i8` is one literal with its sign.
                self.render(source, operand.clone(), &edit.children);
                self.text.push_str(" })");
            }
            Kind::Struct => {
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

    fn branch(&mut self, id: Id, text: &str) {
        let from = self.text.len();
        self.text.push_str(text);
        self.spans.push((id, "m", from..self.text.len()));
    }

    /// `(if on(1) { first } else if on(2) { second } else { `; the caller writes the original and closes.
    fn switch(&mut self, edit: &Edit, mutated: impl Fn(Id, &str, Range<usize>) -> String) {
        self.text.push('(');
        for (id, replacement, gone) in &edit.mutants {
            self.branch(*id, &format!("if {SWITCH}({id}) {{ {} }} else ", mutated(*id, replacement, gone.clone())));
        }
        self.text.push_str("{ ");
    }
}
