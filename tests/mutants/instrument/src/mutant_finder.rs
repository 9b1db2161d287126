//! Where the listed mutants are in a source, and which of them cannot be put behind the switch.

use std::collections::{BTreeSet, HashMap};
use std::ops::Range;

use quote::ToTokens;
use syn::spanned::Spanned;
use syn::visit::{self, Visit};
use syn::{BinOp, Expr, UnOp};

use crate::Id;

pub(crate) enum EditKind {
    Fn,
    Arm,
    Guard,
    Binary { left: Range<usize>, operator: Range<usize>, right: Range<usize> },
    Unary { operator: Range<usize>, operand: Range<usize> },
    Struct,
}

pub(crate) struct Edit {
    pub(crate) range: Range<usize>,
    pub(crate) kind: EditKind,
    /// With the replacement, or for a field of a struct the range that goes.
    pub(crate) mutants: Vec<(Id, String, Range<usize>)>,
    pub(crate) children: Vec<Edit>,
}

impl Edit {
    pub(crate) fn rank(&self) -> u8 {
        match self.kind {
            EditKind::Fn | EditKind::Arm => 0,
            EditKind::Guard => 1,
            _ => 2,
        }
    }
}

pub(crate) struct Finder<'a> {
    pub(crate) text: &'a str,
    pub(crate) by_place: HashMap<(String, usize, usize), Vec<(Id, String)>>,
    /// Why nothing here can be instrumented.
    pub(crate) context: Vec<Option<String>>,
    pub(crate) edits: Vec<Edit>,
    pub(crate) reasons: HashMap<Id, String>,
    pub(crate) texts: HashMap<Id, String>,
    pub(crate) functions: Vec<Range<usize>>,
    pub(crate) needed: &'a BTreeSet<String>,
    pub(crate) matched: BTreeSet<Id>,
}

pub(crate) fn squash(text: &str) -> String {
    text.split_whitespace().collect::<Vec<_>>().join(" ")
}

/// A `let` that makes a condition a chain.
pub(crate) fn has_let(expr: &Expr) -> bool {
    match expr {
        Expr::Let(_) => true,
        Expr::Binary(binary) if matches!(binary.op, BinOp::And(_)) => has_let(&binary.left) || has_let(&binary.right),
        _ => false,
    }
}

pub(crate) fn not_built(attrs: &[syn::Attribute]) -> bool {
    attrs.iter().any(|attr| {
        let text = attr.to_token_stream().to_string();
        attr.path().is_ident("cfg")
            && (text.contains("\"png\"") || text.contains("\"bluetooth\""))
            && !text.contains("not")
            && !text.contains("test")
    })
}

pub(crate) fn returns_impl(output: &syn::ReturnType) -> bool {
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
    pub(crate) fn take(&mut self, genre: &str, span: proc_macro2::Span) -> Vec<(Id, String)> {
        let start = span.start();
        let found = self.by_place.remove(&(genre.to_owned(), start.line, start.column + 1)).unwrap_or_default();
        self.matched.extend(found.iter().map(|(id, _)| *id));
        found
    }
    /// Notes the text; true if the place can be instrumented.
    pub(crate) fn note(&mut self, found: &[(Id, String)], text: &str, refusal: Option<&str>) -> bool {
        let reason = refusal.map(str::to_owned).or_else(|| self.context.last().cloned().flatten());
        for (id, _) in found {
            self.texts.insert(*id, squash(text));
            if let Some(reason) = &reason {
                self.reasons.insert(*id, reason.clone());
            }
        }
        !found.is_empty() && reason.is_none()
    }
    pub(crate) fn push(&mut self, range: Range<usize>, kind: EditKind, found: Vec<(Id, String)>) {
        let mutants = found.into_iter().map(|(id, replacement)| (id, replacement, 0..0)).collect();
        self.edits.push(Edit { range, kind, mutants, children: vec![] });
    }
    pub(crate) fn within(&mut self, reason: Option<&str>, visit: impl FnOnce(&mut Self)) {
        self.context.push(reason.map(str::to_owned));
        visit(self);
        self.context.pop();
    }
    /// In a constant context unless something worse is known.
    pub(crate) fn constant(&mut self, reason: &str, visit: impl FnOnce(&mut Self)) {
        self.within(Some(reason), visit);
    }
    pub(crate) fn function(
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
                    this.push(start..start, EditKind::Fn, found);
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
            self.push(left.start..right.end, EditKind::Binary { left, operator, right }, found);
        }
        visit::visit_expr_binary(self, i);
    }
    fn visit_expr_unary(&mut self, i: &'a syn::ExprUnary) {
        if matches!(i.op, UnOp::Not(_) | UnOp::Neg(_)) {
            let found = self.take("UnaryOperator", i.op.span());
            let (operator, operand) = (i.op.span().byte_range(), i.expr.span().byte_range());
            let text = self.text;
            if self.note(&found, &text[operator.start..operand.end], None) {
                self.push(operator.start..operand.end, EditKind::Unary { operator, operand }, found);
            }
        }
        visit::visit_expr_unary(self, i);
    }
    fn visit_arm(&mut self, i: &'a syn::Arm) {
        let text = self.text;
        let found = self.take("MatchArm", i.span());
        let pat = i.pat.span().byte_range();
        if self.note(&found, &text[pat.clone()], None) {
            self.push(pat.end..pat.end, EditKind::Arm, found);
        }
        if let Some((_, guard)) = &i.guard {
            let found = self.take("MatchArmGuard", guard.span());
            let range = guard.span().byte_range();
            let refusal = has_let(guard).then_some("let guard");
            if self.note(&found, &text[range.clone()], refusal) {
                self.push(range, EditKind::Guard, found);
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
                self.edits.push(Edit { range, kind: EditKind::Struct, mutants, children: vec![] });
            }
        }
        visit::visit_expr_struct(self, i);
    }
}
