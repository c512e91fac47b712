// Code and tables that are wider than the page can be scrolled by the keyboard.
window.addEventListener("load", () => {
  for (const wide of document.querySelectorAll("pre > code, .md-typeset__scrollwrap"))
    wide.tabIndex = 0;
});
