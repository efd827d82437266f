// Files that another program drops on the window, by the X protocol XDND (version 5).
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <array>
#include <chrono>
#include <string>
#include <thread>
#include <vector>

#include "render/gl/context.hpp"

// Last, because it defines common words as macros.
#include <X11/Xatom.h>
#include <X11/Xlib.h>

namespace penumbra {
namespace {

constexpr const char* kTitle = "penumbra drop test";

// Returns the window with this title, or 0.
::Window find_window(Display* display, ::Window parent, const std::string& title) {
  char* name = nullptr;
  if (XFetchName(display, parent, &name) != 0 && name != nullptr) {
    const bool found = title == name;
    XFree(name);
    if (found) return parent;
  }
  ::Window root = 0;
  ::Window above = 0;
  ::Window* children = nullptr;
  unsigned count = 0;
  ::Window result = 0;
  if (XQueryTree(display, parent, &root, &above, &children, &count) == 0) return 0;
  for (unsigned i = 0; i < count && result == 0; ++i)
    result = find_window(display, children[i], title);
  if (children != nullptr) XFree(children);
  return result;
}

// The program that drags files.
class DragSource {
 public:
  DragSource(Display* display, ::Window target)
      : display_(display),
        target_(target),
        source_(XCreateSimpleWindow(display, DefaultRootWindow(display), 0, 0, 1, 1, 0, 0, 0)) {
    XSetSelectionOwner(display_, atom("XdndSelection"), source_, CurrentTime);
  }
  ~DragSource() { XDestroyWindow(display_, source_); }
  DragSource(const DragSource&) = delete;
  DragSource& operator=(const DragSource&) = delete;

  void drop(const std::string& uris) {
    uris_ = uris;
    constexpr long kVersion = 5;
    send("XdndEnter", {kVersion << 24, static_cast<long>(atom("text/uri-list")), 0, 0});
    send("XdndPosition",
         {0, (20L << 16) | 20L, CurrentTime, static_cast<long>(atom("XdndActionCopy"))});
    send("XdndDrop", {0, CurrentTime, 0, 0});
    XFlush(display_);
  }
  // Sends the names of the files when the window asks for them.
  void answer() {
    while (XPending(display_) > 0) {
      XEvent event;
      XNextEvent(display_, &event);
      if (event.type != SelectionRequest) continue;
      const XSelectionRequestEvent& request = event.xselectionrequest;
      XChangeProperty(display_, request.requestor, request.property, request.target, 8,
                      PropModeReplace, reinterpret_cast<const unsigned char*>(uris_.data()),
                      static_cast<int>(uris_.size()));
      XEvent reply{};
      reply.xselection.type = SelectionNotify;
      reply.xselection.requestor = request.requestor;
      reply.xselection.selection = request.selection;
      reply.xselection.target = request.target;
      reply.xselection.property = request.property;
      reply.xselection.time = request.time;
      XSendEvent(display_, request.requestor, False, NoEventMask, &reply);
      XFlush(display_);
    }
  }

 private:
  [[nodiscard]] Atom atom(const char* name) const { return XInternAtom(display_, name, False); }
  // `data`: the message's words after the source window.
  void send(const char* type, const std::array<long, 4>& data) {
    XEvent event{};
    event.xclient.type = ClientMessage;
    event.xclient.window = target_;
    event.xclient.message_type = atom(type);
    event.xclient.format = 32;
    event.xclient.data.l[0] = static_cast<long>(source_);
    for (std::size_t i = 0; i < data.size(); ++i) event.xclient.data.l[i + 1] = data[i];
    XSendEvent(display_, target_, False, NoEventMask, &event);
  }

  Display* display_;
  ::Window target_;
  ::Window source_;
  std::string uris_;
};

TEST(Window, ShowsEventForEachDroppedFile) {
  if (!display_available()) GTEST_SKIP() << "no display: DISPLAY and WAYLAND_DISPLAY are not set";
  WindowOptions options;
  options.title = kTitle;
  options.vsync = false;
  const auto context = create_window_context(options);
  ASSERT_TRUE(context) << context.error().message;
  std::vector<std::string> dropped;
  (*context)->on_event([&dropped](const WindowEvent& event) {
    if (event.kind == WindowEvent::Kind::file_dropped) dropped.push_back(event.file);
  });
  Display* display = XOpenDisplay(nullptr);
  ASSERT_NE(display, nullptr);
  {
    const ::Window target = find_window(display, DefaultRootWindow(display), kTitle);
    ASSERT_NE(target, 0U);
    DragSource source(display, target);
    source.drop("file:///models/red%20boat.glb\r\nfile:///models/b,1.obj\r\n");
    for (int i = 0; i < 500 && dropped.empty(); ++i) {
      EXPECT_TRUE((*context)->poll_events());
      source.answer();
      std::this_thread::sleep_for(std::chrono::milliseconds(10));
    }
  }
  XCloseDisplay(display);
  EXPECT_THAT(dropped, testing::ElementsAre("/models/red boat.glb", "/models/b,1.obj"));
}

}  // namespace
}  // namespace penumbra
