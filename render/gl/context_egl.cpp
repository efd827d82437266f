// Offscreen contexts through EGL, without a window system or display.
#include <epoxy/egl.h>
#include <epoxy/gl.h>

#include <array>
#include <string_view>
#include <vector>

#include "render/gl/context.hpp"

namespace penumbra {
namespace {

bool has_extension(const char* extensions, const char* name) {
  return extensions != nullptr && epoxy_extension_in_string(extensions, name);
}

std::string_view egl_error_name(EGLint error) {
  constexpr std::pair<EGLint, std::string_view> kNames[] = {
      {EGL_SUCCESS, "no error given"},    {EGL_NOT_INITIALIZED, "EGL_NOT_INITIALIZED"},
      {EGL_BAD_ALLOC, "EGL_BAD_ALLOC"},   {EGL_BAD_ATTRIBUTE, "EGL_BAD_ATTRIBUTE"},
      {EGL_BAD_CONFIG, "EGL_BAD_CONFIG"}, {EGL_BAD_MATCH, "EGL_BAD_MATCH"}};
  for (const auto& [code, name] : kNames) {
    if (code == error) return name;
  }
  return "another EGL error";
}

class EglContext final : public GlContext {
 public:
  EglContext(EGLDisplay display, EGLContext context, GlApi api)
      : display_(display),
        context_(context),
        api_name_(api == GlApi::gl33 ? EGL_OPENGL_API : EGL_OPENGL_ES_API) {}
  ~EglContext() override {
    if (eglGetCurrentContext() == context_)
      eglMakeCurrent(display_, EGL_NO_SURFACE, EGL_NO_SURFACE, EGL_NO_CONTEXT);
    eglDestroyContext(display_, context_);
    // No eglTerminate(): it would end the other contexts of the display.
  }

  bool bind() {
    eglBindAPI(api_name_);
    return eglMakeCurrent(display_, EGL_NO_SURFACE, EGL_NO_SURFACE, context_) == EGL_TRUE;
  }
  void read_info(GlApi api) { info_ = current_gl_info(api); }
  void make_current() override { bind(); }

 private:
  EGLDisplay display_;
  EGLContext context_;
  EGLenum api_name_;
};

struct Platform {
  const char* name;
  EGLDisplay display;
};

// Returns the displays in order of preference. The default display is last, because some drivers
// need a window system for it.
std::vector<Platform> find_platforms() {
  std::vector<Platform> platforms;
  const char* client = eglQueryString(EGL_NO_DISPLAY, EGL_EXTENSIONS);
  if (has_extension(client, "EGL_EXT_platform_base")) {
    if (has_extension(client, "EGL_MESA_platform_surfaceless")) {
      platforms.push_back({"surfaceless", eglGetPlatformDisplayEXT(EGL_PLATFORM_SURFACELESS_MESA,
                                                                   EGL_DEFAULT_DISPLAY, nullptr)});
    }
    const bool enumerates = has_extension(client, "EGL_EXT_device_base") ||
                            has_extension(client, "EGL_EXT_device_enumeration");
    if (enumerates && has_extension(client, "EGL_EXT_platform_device")) {
      std::array<EGLDeviceEXT, 16> devices{};
      EGLint count = 0;
      if (eglQueryDevicesEXT(static_cast<EGLint>(devices.size()), devices.data(), &count) ==
          EGL_TRUE) {
        for (EGLint i = 0; i < count; ++i) {
          platforms.push_back(
              {"device", eglGetPlatformDisplayEXT(EGL_PLATFORM_DEVICE_EXT,
                                                  devices[static_cast<std::size_t>(i)], nullptr)});
        }
      }
    }
  }
  platforms.push_back({"default display", eglGetDisplay(EGL_DEFAULT_DISPLAY)});
  return platforms;
}

// Returns the attribute that enables reports of driver resets, or EGL_NONE. Its value is always
// EGL_LOSE_CONTEXT_ON_RESET.
EGLint reset_notification_attribute(GlApi api, EGLint major, EGLint minor, const char* extensions) {
  if (api == GlApi::gles30 && has_extension(extensions, "EGL_EXT_create_context_robustness"))
    return EGL_CONTEXT_OPENGL_RESET_NOTIFICATION_STRATEGY_EXT;
  const bool core = major > 1 || (major == 1 && minor >= 5);
  if (core || (api == GlApi::gl33 && has_extension(extensions, "EGL_KHR_create_context")))
    return EGL_CONTEXT_OPENGL_RESET_NOTIFICATION_STRATEGY;
  return EGL_NONE;
}

// Returns a context, or an error that reports the missing feature of this platform.
Result<std::unique_ptr<GlContext>> try_platform(const Platform& platform, GlApi api) {
  if (platform.display == EGL_NO_DISPLAY) return fail("{}: does not exist", platform.name);
  EGLint major = 0;
  EGLint minor = 0;
  if (eglInitialize(platform.display, &major, &minor) != EGL_TRUE)
    return fail("{}: {}", platform.name, egl_error_name(eglGetError()));
  const char* extensions = eglQueryString(platform.display, EGL_EXTENSIONS);
  if (!has_extension(extensions, "EGL_KHR_surfaceless_context"))
    return fail("{}: no EGL_KHR_surfaceless_context", platform.name);

  const EGLenum api_name = api == GlApi::gl33 ? EGL_OPENGL_API : EGL_OPENGL_ES_API;
  if (eglBindAPI(api_name) != EGL_TRUE) return fail("{}: the API is not available", platform.name);
  EGLConfig config = nullptr;  // EGL_NO_CONFIG_KHR
  if (!has_extension(extensions, "EGL_KHR_no_config_context")) {
    const std::array<EGLint, 5> of_config = {
        EGL_RENDERABLE_TYPE, api == GlApi::gl33 ? EGL_OPENGL_BIT : EGL_OPENGL_ES3_BIT,
        EGL_SURFACE_TYPE, EGL_PBUFFER_BIT, EGL_NONE};
    EGLint count = 0;
    if (eglChooseConfig(platform.display, of_config.data(), &config, 1, &count) != EGL_TRUE ||
        count < 1)
      return fail("{}: no framebuffer configuration", platform.name);
  }
  std::vector<EGLint> wanted = {EGL_CONTEXT_CLIENT_VERSION, 3};
  if (api == GlApi::gl33) {
    wanted.insert(wanted.end(), {EGL_CONTEXT_MINOR_VERSION, 3, EGL_CONTEXT_OPENGL_PROFILE_MASK,
                                 EGL_CONTEXT_OPENGL_CORE_PROFILE_BIT});
  }
  const auto create = [&](std::vector<EGLint> attributes) {
    attributes.push_back(EGL_NONE);
    return eglCreateContext(platform.display, config, EGL_NO_CONTEXT, attributes.data());
  };
  EGLContext context = EGL_NO_CONTEXT;
  if (const EGLint attribute = reset_notification_attribute(api, major, minor, extensions);
      attribute != EGL_NONE) {
    std::vector<EGLint> with_notification = wanted;
    with_notification.insert(with_notification.end(), {attribute, EGL_LOSE_CONTEXT_ON_RESET});
    context = create(with_notification);
  }
  if (context == EGL_NO_CONTEXT) context = create(wanted);
  if (context == EGL_NO_CONTEXT)
    return fail("{}: {}", platform.name, egl_error_name(eglGetError()));
  auto owner = std::make_unique<EglContext>(platform.display, context, api);
  if (!owner->bind()) return fail("{}: {}", platform.name, egl_error_name(eglGetError()));
  owner->read_info(api);
  return owner;
}

}  // namespace

Result<std::unique_ptr<GlContext>> create_offscreen_context(GlApi api) {
  std::string causes;
  for (const Platform& platform : find_platforms()) {
    Result<std::unique_ptr<GlContext>> context = try_platform(platform, api);
    if (context) return context;
    if (!causes.empty()) causes += "; ";
    causes += context.error().message;
  }
  return fail(
      "EGL gives no {} context without a display ({}); install a Mesa driver (Debian: "
      "libegl-mesa0, libgl1-mesa-dri)",
      api == GlApi::gl33 ? "OpenGL 3.3 core" : "OpenGL ES 3.0", causes);
}

}  // namespace penumbra
